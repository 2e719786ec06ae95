"""Time: a scenario, its simulation step by step, and what a run leaves. Imports all other packages.

What it offers to `luxloop` and the command line: `run.run` and `run.prepare`; the typed scenario in `scenario.model`, made into objects by
`assembly`; what simulations run on in `plant`, the simulation in `lighting`, copies of it in `batch`, one as an `environment` to learn in;
`replay` of recordings and their edits; `recording`, its `report` and the `labels` beside its frames; `studies` such as tuning and campaigns
on `jobs`; `evaluation` of pixel controllers, `training` of detectors, a `dataset` for those of others, `beams` found for a detector;
`contracts`, checks of what users write; `pictures`, and what to `export`; the `studio` in the browser, and `client`, for other programs;
`remote`, another simulator as the plant; `rig`, a real lamp and camera as a plant; `wire`, the bytes between a loop and a rig, `bench`, a
simulated rig as a process of its own, `calibration` of a rig, and `live`, the beam of its lamp as light of the simulated world;
`commands` and their `terminal`.
"""
