"""`luxloop export`: the light of each module at one time, in files that agree with the simulation and with each other."""

import numpy as np
import pytest
import torch

from luxloop import load, read_photometry
from tests.loop.conftest import assert_refused, simulation_of

AT_S = 0.3
SMALL = ["camera.width_px=320", "camera.height_px=133", "renderer=raycast"]


def test_npz_has_the_textures_of_the_modules(lux, tmp_path):
    code, out, error = lux("export", "light", "gfhb", "--at", str(AT_S), "--out", "light.npz", "--set", *SMALL)
    assert (code, error, out) == (0, "", "light.npz written: gfhb at 0.3 s, 1 file\n")
    *_, result = (each for each in simulation_of(load("gfhb", SMALL, steps=4)).evaluations())
    assert result.time_s == pytest.approx(AT_S)
    simulation, arrays = simulation_of(load("gfhb", SMALL)), np.load(tmp_path / "light.npz")
    for module, u in zip(simulation.world.modules, result.lights, strict=True):
        assert np.array_equal(arrays[f"{module.name}.u"].ravel(), u.numpy())
        assert np.array_equal(arrays[f"{module.name}.candela"], module.headlight.light_texture(u).numpy())
        assert np.array_equal(arrays[f"{module.name}.T_body_module"], module.T_body_headlight.double().numpy())
        left, right, bottom, top = arrays[f"{module.name}.border_deg"]
        assert np.tan(np.radians(left)) == pytest.approx(module.headlight.left) and right < left and bottom < top


@pytest.mark.parametrize("suffix", ["ies", "ldt"])
def test_photometric_files_give_the_same_light(suffix, lux, tmp_path):
    code, out, _ = lux("export", "light", "gfhb", "--at", str(AT_S), "--out", f"light.{suffix}", "--set", *SMALL)
    assert code == 0 and "2 files" in out
    simulation = simulation_of(load("gfhb", SMALL))
    lights, _ = simulation.lights_at(AT_S)
    rng = np.random.default_rng(0)
    for module, u in zip(simulation.world.modules, lights, strict=True):
        file = read_photometry(tmp_path / f"light-{module.name.replace(' ', '-')}.{suffix}")
        assert not file.warnings and module.name in file.luminaire
        headlight = module.headlight
        texture = headlight.light_texture(u).double()
        y, z = rng.uniform(headlight.right, headlight.left, 4000), rng.uniform(headlight.bottom, headlight.top, 4000)
        directions = np.stack([np.ones_like(y), y, z])
        wanted = headlight.intensity(texture, torch.from_numpy(directions)).numpy()
        found = file.distribution.intensity(directions)
        # nodes of 0.1 deg, of EULUMDAT also 1 deg round the axis, are coarser than texels of 0.05 deg, beside masks with sharp edges
        assert np.abs(found - wanted).mean() < 0.01 * wanted.max()
        assert found.max() == pytest.approx(wanted.max(), rel=0.05)
        assert not file.distribution.intensity([[1.0], [headlight.left + 0.1], [0.0]]).any(), "dark beyond the field"


def test_a_single_module_has_the_file_alone_and_may_be_dark(lux, tmp_path):
    dark = ["lighting.base.beam=off", "functions={}", 'headlight.lamps=["left"]', "headlight.model=ssl-hd-lores", *SMALL]
    for name in ("dark.ldt", "dark.ies"):
        code, _, error = lux("export", "light", "gfhb", "--out", name, "--step-deg", "1", "--set", *dark, "checks={}")
        assert code == 0, error
        assert not read_photometry(tmp_path / name).distribution.candela.any()
    assert "[_POSITION_M] 0.0000 0.6000 0.7500" in (tmp_path / "dark.ies").read_text()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("light small.toml --out a.txt", "--out a.txt: gives no format of light; end it in .npz, .ies or .ldt"),
        ("light small.toml --out a.ies --step-deg 0", "--step-deg 0: give an angle step"),
        ("light small.toml --out a.ldt --step-deg 9", "--step-deg 9: give an angle step"),
        ("light small.toml --out a.npz --at -1", "--at -1: small lasts 0.1 s"),
        ("scene small.toml --at 100 --out a.glb", "--at 100: small lasts 0.1 s; give a time in it"),
        ("scene small.toml --at nan --out a.glb", "--at nan"),
        ("scene small.toml --out a.obj", "--out a.obj: gives no format of a scene; end it in .glb"),
        ("scene small.toml --out no/where/a.glb", "no/where/a.glb: cannot be written"),
    ],
)
def test_what_cannot_be_written_is_said_in_a_sentence(line, words, lux, tmp_path):
    assert_refused(lux("export", *line.split()), words)
    assert [file.name for file in tmp_path.iterdir()] == ["small.toml"]
