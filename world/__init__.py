"""Lamps, roads, objects, and the light of lamps in a view. Imports none of the other packages.

For them: `params.Params`, `errors.LuxloopError` and `plugin`; poses, angles and a camera's `View` in `frames`, a lamp's `texels.TexelGrid`;
`headlight.Headlight` and `headlight.lamp.Lamp`, from `lamps` and `photometry`, with `regulation`; `spmv` for products with their matrices;
`roads` and `opencrg`, `materials`, `traffic`, and `scene.scene.Scene` of all that; `rendering.gbuffer.gbuffer` of a scene and
`light.illumination` on it; `messages` of arrays for other programs.
"""
