"""Lamps, roads, objects, and the light of lamps in a view. Imports none of the other packages.

What it offers to them: `params.Params`, `errors.LuxloopError` and `plugin`; poses and angles in `frames`, a camera's `view.View` and a
lamp's `texels.TexelGrid`; `headlight.Headlight` and `headlight.lamp.Lamp`, from `presets`, `lampfiles` and `photometry`, with `beams` and
`regulation`; `spmv` for products with their matrices; `roads` and `opencrg`, `materials`, `traffic`, and `scene.scene.Scene` of all that;
`rendering.gbuffer.gbuffer` of a scene and `light.illumination` on it; `messages` of arrays for other programs.
"""
