"""From measurements to light. Imports `perception` and `world`.

For `loop`: pixel controllers, `pixels.ssc.Ssc` and `jpo`, which turn `pixels.primitives.Primitives` into utilisations; symbol controllers
by name, `symbol.build_controller`, with protocol and sensor in `symbol.sensing`; `functions.planner.Planner`, which turns a
`situation.Situation` into a plan, with object-based lighting in `obl` and light by luminance or material in `zones`.
"""
