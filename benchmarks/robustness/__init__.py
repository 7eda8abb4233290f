"""Effect of wrong readings on a closed loop, and equality of the exported C.

`wraps` has an encoder with wrong readings for 1, 3 and 20 samples; `campaign` is a storm of all kinds of wrong readings
on the real plant, driven by Python and replayed by the exported C with sanitizers.
"""
