"""A rig that is simulated in real time, as a process of its own: lamp, screen or road, lens and camera, with faults.

`faults.py` has its keys, `light_input.py` takes light from the network, `timeline.py` knows what is lit when, `scene.py` what the lens sees
of it (`lens.py`), `camera.py` exposes pictures of that, `sensors.py` sends the vehicle's samples, `truth.py` tells tests what was true,
`rig.py` holds them together.
"""
