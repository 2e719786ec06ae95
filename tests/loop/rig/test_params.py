"""The rig file: its paths, and mistakes in it."""

import pytest

from luxloop.loop.rig.lights import open_light
from luxloop.loop.rig.params import (
    load_rig,
)
from luxloop.world.errors import LuxloopError
from tests.loop.rig.conftest import WHOLE


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('kind = "ddp"', 'kind = "dpp"', "light.kind: there is no 'dpp'; did you mean 'ddp'?"),
        ('host = "192.168.1.20"', "", "light.host: is missing; write host ="),
        ("http://192", "https://192", "camera.url:"),
        ("[camera]", "[limits]\npower_w = 20.0\n[camera]", "power_w needs full_w"),
        ("[camera]", "[timing]\nlatency_s = 2.0\n[camera]", "no frame would ever count"),
        ("[camera]", "[light.scan]\nserpentin = true\n[camera]", "light.scan.serpentin: unknown key; did you mean 'serpentine'?"),
        ('host = "192.168.1.20"', 'host = "a"\nkeep_alive_s = 0.09', "the lamp would flicker"),
        ('kind = "ddp"\nhost = "192.168.1.20"', 'kind = "mine:Lamp"', "give --allow-code"),
    ],
)
def test_a_wrong_rig_file_is_a_sentence(rig_file, old, new, words):
    rig_file.write_text(WHOLE.replace(old, new))
    with pytest.raises(LuxloopError) as caught:
        load_rig(rig_file)
    assert str(rig_file) in str(caught.value) and words in str(caught.value)


def test_files_and_modules_of_a_rig_file_lie_beside_it(rig_file):
    (rig_file.parent / "mine.py").write_text("class Lamp:\n    pass\n")
    text = WHOLE.replace('kind = "ddp"\nhost = "192.168.1.20"', 'kind = "mine:Lamp"') + '[calibration]\nfile = "rig.npz"\n'
    rig_file.write_text(text)
    rig = load_rig(rig_file, allow_code=True)
    assert rig.calibration is not None and rig.calibration.file == rig_file.parent / "rig.npz"
    with pytest.raises(LuxloopError, match=r"light.kind: .*mine:Lamp: has no method show"):
        open_light(rig.light, ((2, 2),))
