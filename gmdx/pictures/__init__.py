"""Everything that draws: scenes, grasps, the parts of charts, and pages that hold them.

No other folder imports matplotlib. Studies choose what their charts say, and get figures, keys,
shaded surfaces and pages from here.
"""
