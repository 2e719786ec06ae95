"""From luminance to camera frames, and from frames to measurements and tracks. Imports `world`.

What it offers: `camera.expose` and `camera.camera_view`; a symbol's image and the reason of its loss by `extraction`, centroids and errors
by `appearance`, bird's-eye views by `birdseye`; `egomotion.Ego`; detectors in `detection`, `tracking`; and what only a simulated world
provides: `ground_truth`, `evaluator`.
"""
