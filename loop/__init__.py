"""Time: a scenario, its simulation step by step, and what a run leaves. Imports all other packages.

`scenario` is the typed configuration; `simulation` builds its parts, its plant among them, and steps them. All else uses a simulation:
`run.run` records one; `recording` keeps, replays and compares runs, `report` draws them; `rig` is a real lamp and camera as a plant, or
simulated as a process of its own; `studies` runs many: campaigns, tuning, environments to learn in, training of detectors; `studio` shows
one in the browser; `commands` is the command line.
"""
