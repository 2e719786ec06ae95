"""What an observer sees of a symbol on the road is the picture that he shall see."""

import math
from pathlib import Path

import pytest
import torch

from luxloop.controllers.functions.symbol import SymbolFunctionParams
from luxloop.controllers.pixels.homographies import drawing_rectangle
from luxloop.controllers.pixels.ssc import Ssc
from luxloop.controllers.situation import Situation
from luxloop.perception.metrics import iou
from luxloop.world.frames import inverse, pose_from_degrees, transform
from luxloop.world.lamps.presets import lamp
from luxloop.world.symbols import Still, load_still

SYMBOLS = Path(__file__).parents[3] / "scenarios" / "symbols"
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def flying() -> tuple[torch.Tensor, ...]:
    """A symbol 1.6 m wide and 0.6 m high, upright 10 m ahead, seen by a driver."""
    origin = torch.tensor([10.0, 0.8, 1.0], dtype=torch.float64)
    return origin, *torch.tensor([[0.0, -1.6, 0.0], [0.0, 0.0, -0.6]], dtype=torch.float64), torch.tensor([-1.0, 0.3, 1.3]).double()


def test_the_rectangle_holds_what_is_seen_and_is_no_larger_than_any_other():
    origin, d1, d2, eye = flying()
    p, a, b = drawing_rectangle(origin, d1, d2, eye, torch.zeros(3).double(), UP)
    assert torch.linalg.cross(a, b)[2] > 0 and p[2] == a[2] == b[2] == 0
    edge = torch.linspace(0, 1, 9, dtype=torch.float64)
    through = origin + edge[:, None, None] * d1 + edge[:, None] * d2 - eye
    seen = (eye + through * (-eye[2] / through[..., 2:])).reshape(-1, 3) - p
    u, v = seen @ a / (a @ a), seen @ b / (b @ b)
    for each in (u, v):
        assert each.min().item() == pytest.approx(0, abs=1e-9) and each.max().item() == pytest.approx(1, abs=1e-9)
    area = a.norm() * b.norm()
    for angle in torch.linspace(0, math.pi / 2, 91).tolist():
        turned = seen[:, :2] @ torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]).double()
        assert area <= (turned.amax(0) - turned.amin(0)).prod() + 1e-9


def test_what_is_above_the_horizon_cannot_be_drawn():
    origin, d1, d2, eye = flying()
    above = drawing_rectangle(origin + 2 * UP, d1, d2, eye, torch.zeros(3).double(), UP)
    assert torch.isnan(torch.stack(above)).any()


# Eye, and the picture's middle, width and height: as large as the field of the lamp, 14 x 7 deg, lets it be.
OBSERVERS = {
    "driver": ((-1.6, 0.35, 1.3), (9.0, 0.0, 0.4), 1.0, 0.2),
    "cyclist": ((28.0, 2.5, 1.6), (21.0, 1.5, 0.8), 0.6, 0.2),
    "pedestrian": ((14.0, 6.0, 1.6), (13.7, 3.1, 0.72), 1.0, 0.25),
}


@pytest.fixture(scope="module")
def ssc() -> Ssc:
    return Ssc.prepare(lamp("dmd-1m3").finest.headlight)


@pytest.mark.parametrize("who", OBSERVERS)
def test_the_observer_sees_what_he_shall_see(who, ssc):
    """IoU of what is lit more than half as bright as the lamp can, with the wanted image, in a camera that looks through the picture."""
    eye_m, centre_m, width_m, height_m = OBSERVERS[who]
    image, light, T = load_still(SYMBOLS / "chevrons.png"), ssc.headlight, pose_from_degrees((0.0, 0.6, 0.75))
    observer = {"eye_m": eye_m, "centre_m": centre_m, "width_m": width_m, "height_m": height_m}
    now = Situation(0.0, torch.eye(4, dtype=torch.float64), T[None, :3, 3], symbols={"a": Still(image)})
    (p,) = SymbolFunctionParams(image="a", observer=observer).primitives(now)
    picture = [v[0] for v in (p.observer.eye, p.observer.origin, p.observer.d1, p.observer.d2)]
    u = ssc.utilisation(p.to(torch.float32), T).u

    rows, cols = round(640 * height_m / width_m), 640
    x, y = torch.meshgrid((torch.arange(cols) + 0.5) / cols, (torch.arange(rows) + 0.5) / rows, indexing="xy")
    eye, origin, d1, d2 = picture
    ray = origin + x[..., None] * d1 + y[..., None] * d2 - eye
    road = (eye + ray * (-eye[2] / ray[..., 2:])).flatten(0, 1).T
    local = transform(inverse(T), road).float()
    lit, full = (light.intensity(light.light_texture(each), local) for each in (u, torch.ones_like(u)))
    assert full.min() > 0  # all of the picture lies in the lamp's field
    wanted = torch.nn.functional.interpolate(image[None, None], (rows, cols), mode="bilinear")[0, 0] > 0.5
    assert iou((lit > full / 2).view(rows, cols), wanted) >= 0.97  # 0.983, 0.983 and 0.979
