"""Small files in the layouts of ARAMIS, GOM, MatchID and general DIC tables, as their software writes them."""

from __future__ import annotations

ARAMIS = (
    "# Units: length:mm angle:deg time:s\r\n# Stage: Stufe 2\r\nstage;index;relative_time;date\r\n"
    '"Stufe 2";2;21.5551;"2023-02-10T13:54:18.404"\r\n# Name : Fl\u00e4chenkomponente 1\r\n'
    "id;x;y;z;displacement_x;displacement_y;displacement_z;epsilon_x;epsilon_y;mises_strain;thickness_strain\r\n"
    "0;12.3458;-9.4783;-0.2030;0.0004;-0.0007;0.0005;0.0014;0.0002;0.0018;-0.0016\r\n"
    "1;12.8458;-9.4783;-0.2030;0.0005;-0.0006;0.0004;0.0015;0.0003;0.0019;-0.0017\r\n"
    "7;13.3458;-9.4783;-0.2031;0.0006;-0.0005;0.0003;0.0016;0.0004;0.0020;-0.0018\r\n"
).encode()
ARAMIS_COMMAS = (
    b"# Units: length:mm angle:deg time:s\n# Stage: 2\nstage,index,relative_time,date\n2,2,0.5,2021\n# Name : surface\n"
    b"id,x,y,z,x,y,z,displacement_x,displacement_y,displacement_z\n"
    b"0,1.5000,2.0000,0.1,11.5000,22.0000,0.1,0.5,1.0,0.1\n"
    b"1,2.5000,2.0000,0.1,12.5000,22.0000,0.1,0.5,1.0,0.1\n"
    b"2,3.5000,2.0000,0.1,13.5000,22.0000,0.1,,,\n"
)
GOM = b"# Name : shell\n# Stage: 151\n# Units: length:mm angle:deg \nid,x,y,z\n2,425.3251,95.5139,-5.9624\n3,427.67,95.36,1.3193\n5,1,2,3\n"
_BAR = "#" * 100
NODEMAP = (
    f"{_BAR}\n#                    project_name : test\n#              process area : 20 mm\u00b2\n{_BAR}\n"
    "#         facet_size : 20\n#         current_stage_index : 52\n#        current_stage_relative_date : 12.5\n"
    f"{_BAR}\n# SIGNALS\n# force : value_element : 14985.6119156\n# Kraft : analog_input : 15102.5390625\n{_BAR}\n"
    "#        ID;         x_undef [mm];         y_undef [mm];         z_undef [mm];               u [mm];               v [mm];"
    "               w [mm];             epsx [%];             epsy [%];            epsxy [1];           epseqv [%]\n"
    "          1;          -1.50000000;           2.00000000;           0.10000000;           0.01000000;           0.02000000;"
    "           0.00100000;           0.10000000;           0.20000000;           0.00300000;           0.40000000\n"
    "          2;           1.50000000;           2.00000000;           0.10000000;                  nan;                  nan;"
    "                  nan;                  nan;                  nan;                  nan;                  nan\n"
    "          4;           4.50000000;           2.00000000;           0.10000000;           0.03000000;           0.02000000;"
    "           0.00100000;           0.10000000;           0.20000000;           0.00300000;           0.40000000\n"
).encode("latin-1")
CONNECTIONS = b"#      Type;   Element #;   Node 1;   Node 2;   Node 3\n   3;  0;  0;  1;  2\n"
LEGACY = (
    b"# this is a demo-export\n#\n# Stage :   0  -  12 \n# AD-Channels:  undeformt    deformt   Unit\n"
    b"#     AD-0:     0.010    5.250    V\n#\n# Time  :  undeformt: 1360000000.50     [seconds since 01.01.1970]\n"
    b"#            deformt: 1360000012.75     [seconds since 01.01.1970]\n#\n"
    b"# Index_x, Index_y, Coordinate-undef (x,y,z), Coord-def (x,y,z), Displ(x,y,z), Strain (x,y,Major, Minor, Thicknessreduction), "
    b"AD-Channel 1 + 2\n#\n"
    b"   3    4\n1.0 2.0 0.5\n1.1 2.2 0.5\n0.1 0.2 0.0\n1.5 2.5\n3.0 -1.0 -2.0\n"
    b"   4    4\n2.0 2.0 0.5\n2.1 2.2 0.5\n0.1 0.2 0.0\n1.5 2.5\n3.0 -1.0 -2.0\n"
)
LEGACY_COORDINATES = b"# Stage :   0  -  0 \n# Index_x, Index_y, Coordinate-undef (x,y,z)\n3 4\n1,0 2,0 0,5\n4 4\n2,0 2,0 0,5\n"
LEGACY_DISPLACEMENTS = b"# Stage :   0  -  7 \n# Index_x, Index_y, Displ(x,y,z)\n3 4\n0,1 0,2 0,0\n4 4\n0,1 0,3 0,0\n"
SECTION = b"Sectionlength deltaL\n0,000000  -0,001500\n0,133532  -0,001535\n0,267000  0,001600\n"
MATCHID = (
    b"coor.Image X [mm];coor.Image Y [mm];disp.Horizontal Displacement U [mm];disp.Vertical Displacement V [mm];"
    b"strain.Strain-global frame: Exx [ ];strain.Strain-global frame: Eyy [ ];strain.Strain-global frame: Exy [ ]\r\n"
    b"7.425000000E+000;1.077500000E+001;8.892792286E-004;-1.763503367E-001;-4.806529075E-005;7.441691839E-003;-1.178887359E-003\r\n"
    b"1.217500000E+001;1.390000000E+001;-6.879484919E-004;-1.699327147E-001;-2.266595088E-003;1.019059435E-002;-3.171625606E-003\r\n"
    b"8.925000000E+000;2.690000000E+001;0.000000000E+000;0.000000000E+000;0.000000000E+000;0.000000000E+000;0.000000000E+000\r\n"
    b"9.925000000E+000;2.690000000E+001;1.000000000E-003;2.000000000E-003;0.000000000E+000;0.000000000E+000;0.000000000E+000\r\n"
)
MATCHID_3D = (
    b"Coordinates.Image X [Pixel],Coordinates.Image Y [Pixel],coor.X [mm],coor.Y [mm],coor.Z [mm],disp.Horizontal Displacement U [mm],"
    b"disp.Vertical Displacement V [mm],disp.Out-Of-Plane: W [mm],strain.Strain-global frame: Exx [ ]\n"
    b"100,200,1.5,2.5,0.5,0.5,0.25,0.125,0.001\n110,200,2.5,2.5,0.5,0.5,0.25,0.125,0.001\n120,200,0,0,0,0,0,0,0\n"
)
MATRIX = b"0,001;Non un numero reale;-0,003;\n0,004;0,005;0,006;\n0,007;\n"
LOAD = b"File;TimeStamp; Force [V]; Force [N]\nI_0001.tiff;10.5;0.1;1000\nI_0002.tiff;11.5;0.2;2000.5\nI_0003.tiff;12.5;0.3;3001\n"
TABLE = (
    b"x-coordinate [mm],y-coordinate [mm],x-displacement [mm],y-displacement [mm]\n"
    b"-1.2132,18.6820,0.0370,-0.0073\n-0.1821,1.2009,0.0100,0.0060\n2.0,3.0,,\n"
)
