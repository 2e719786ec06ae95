"""A rig simulated in real time as a process of its own: lamp, screen or road, lens and camera, with faults.

`faults.py` has the keys, `lamp.py` receives light and keeps its timeline, `scene.py` renders the scene through the lens (`lens.py`),
`camera.py` exposes pictures, `board.py` shows a calibration board and luxmeter readings, `rig.py` joins them, sends sensor samples and
serves the truth for tests.
"""
