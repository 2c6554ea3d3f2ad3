"""One material point under uniaxial stress with a lumped heat balance: the driver of coupon records."""
