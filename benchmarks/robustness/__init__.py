"""What do wrong readings do to a closed loop, and does the exported C do the same?

`wraps` lets an encoder say something wrong for 1, 3 and 20 samples; `campaign` is a storm of all kinds of wrong
readings on the real plant, driven by Python and replayed by the exported C with sanitizers.
"""
