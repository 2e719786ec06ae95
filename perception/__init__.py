"""From luminance to camera frames, and from frames to measurements and tracks. Imports `world`.

`camera.expose` and `camera.camera_view`; symbol images or reasons of their loss by `extraction`, centroids and errors by `appearance`,
bird's-eye views by `birdseye`; `egomotion.Ego`; detectors in `detection`, `tracking`; for simulated worlds only: `ground_truth`, `metrics`.
"""
