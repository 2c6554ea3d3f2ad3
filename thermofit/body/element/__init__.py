"""The hex8 element: kinematics, internal forces, stiffness, energy."""
