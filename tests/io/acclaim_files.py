"""A small skeleton and motion as Acclaim text, with what real files do rarely."""

ASF = """# a comment
:version 1.10
:name small
:units
  mass 1.0
  length 0.45
  angle deg
:documentation
   :not a section? it is text
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     id 1
     name hip
     direction 0 -1 0
     length 2
     axis 0 0 30  XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 inf)
  end
  begin
     id 2
     name knee
     direction 0 -1 0
     length 3
     axis 10 20 30  ZYX
    dof rz rx
  end
  begin
     id 3
     name foot
     direction 0 0 1
     length 1
     axis 0 0 0  XYZ
  end
  begin
     id 4
     name spine
     direction 0 1 0
     length 5
     axis 0 0 0  XYZ
    dof tx ry l
  end
  begin
     id 5
     name head
     direction 0 1 0
     length 1
     axis 0 90 0  XYZ
    dof rx
  end
:hierarchy
  begin
    root hip spine
    hip knee
    knee foot
    spine head
  end
"""

AMC = """#!OML:ASF C:\\capture\\small.ASF
:FULLY-SPECIFIED
:DEGREES
1
root 1 20 3 10 20 30
hip 5 6 7
knee 40 -3
spine 0 0 0
head 12
2
root 1.5 20 3 11 21 31
hip 5.5 6 7.25
knee 41e0 -3
spine 0.5 10 0.25
head -12.000
3
root 2 20 3 12 22 32
hip 6 6 7.5
knee 42 -3.5
spine 1 20 0.5
head 1
"""
