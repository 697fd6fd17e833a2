"""What the Blender extension and the hand-over of .blend files share. `rig`, `handover`, `unshown` and `usd` take `bpy`; all else is plain Python.

Lengths in the display are millimetres, in the scene Blender's units. Display space has x to the right, y up, z to the viewer and z = 0 on the
plane of zero parallax.
"""
