"""How near light by material comes to what is wanted: `python material_light.py [LAMP]`, of the scenario `materials`.

It imports from internal packages of luxloop, which may change.
"""

import sys

from luxloop import load, prepare
from luxloop.perception.ground_truth import material_picture

REACH_M = (12.0, 45.0)  # ahead, where both lamps light the road


def main(lamp: str = "ssl-hd-lores") -> None:
    """A line a material: wanted and mean illuminance in lx, and the share of its pixels within 30 % of what is wanted."""
    simulation = prepare(load("materials", [f"headlight.model={lamp}"]))
    state = simulation.start()
    for _ in range(3):
        state, result = simulation.step(state)
    evaluation = simulation.evaluate(result)
    lit = simulation.world.lit(result.time_s)
    picture, names = material_picture(lit.surfaces, lit.triangles)
    (asked,) = (each.lx for each in result.planning.functions.values())
    within = (lit.surfaces.position[0] > REACH_M[0]) & (lit.surfaces.position[0] < REACH_M[1])
    print(f"{lamp}: {sum(power.flux_lm for power in result.powers.values()):.0f} lm")
    for number, name in enumerate(names):
        mask = (picture == number) & within & ~asked.isnan()
        if int(mask.sum()) >= 50:
            wanted, light = asked[mask], evaluation.illuminance[mask]
            near = ((light / wanted - 1).abs() < 0.3).double().mean()
            asked_for, given = float(wanted.median()), float(light.median())
            print(f"{name:22} {int(mask.sum()):6} px, wanted {asked_for:6.2f} lx, median {given:6.2f} lx, {near:4.0%} near")


if __name__ == "__main__":
    main(*sys.argv[1:])
