"""Broken scenario files: whatever is wrong is said in one sentence with file, key and remedy."""

import random
from collections.abc import Iterator
from typing import Any

import pytest

from luxloop import load
from luxloop.loop.scenario.shipped import scenario_files
from tests.loop.scenario.files import BOX, GOOD, LIT, PID, SYMBOL, failure, is_one_sentence
from tests.refusal import refusal

# what is wrong, what the file has then, what the sentence must name: the key and the remedy
BROKEN = {
    "unknown key": ('stepps = 3\nname = "x"', "stepps", "'steps'"),
    "unknown key far from any": ('zzz = 3\nname = "x"', "zzz", "known are", "camera"),
    "typo in a variant": (GOOD + '[road]\nkind = "bumps"\nsead = 3', "road.sead", "'seed'"),
    "typo deep in a controller": (
        PID + "position = {kpp = 1}",
        "functions.symbol.controller.position.kpp",
        "'kp'",
    ),
    "text for a whole number": ('steps = "40"\n' + GOOD.replace("steps = 3", ""), "steps", "'40'", "whole number"),
    "value for a table": ("camera = 3" + GOOD, ": camera: ", "table"),
    "name for a table": (GOOD + '[lighting]\nbase = "low"', "lighting.base", 'write base = {beam = "low"}'),
    "key of an inner table": (GOOD + '[lighting]\nbeam = "low"', "lighting.beam", 'write base = {beam = "low"}'),
    "table for a list": (GOOD + BOX.replace("[[objects]]", "[objects]"), "write [[objects]] above each"),
    "beyond half a turn": (GOOD + BOX.replace("0]}", "0], yaw_deg = 270}"), "objects[0].track[0].yaw_deg", "180; write -90"),
    "above the range": (GOOD + "[camera]\nhfov_deg = 200", "camera.hfov_deg", "less than or equal to 150"),
    "infinity": (GOOD + "[camera]\nexposure_s = inf", "camera.exposure_s", "inf", "finite"),
    "a date": ("seed = 2024-01-01" + GOOD, "seed: is a date", "number"),
    "no image": (
        'name = "x"\n[functions.symbol]\nkind = "symbol"',
        'functions.symbol.image: is missing; write image = "snowflake"',
        "luxloop new",
    ),
    "no name": (GOOD.replace('name = "good"', ""), 'name: is missing; write name = "mine", say: name, for tables and reports ('),
    "a symbol beside the functions": (
        'symbol = {image = "snowflake"}' + GOOD,
        "symbol: unknown key",
        "[functions.NAME]",
        'kind = "symbol"',
    ),
    "a start without control": (
        SYMBOL + "start = {x_m = 12.0}",
        "functions.symbol: start: ",
        'give controller = "luxloop"',
        "leave it out",
    ),
    "animation under control": (GOOD + 'animation = {kind = "blinking"}', "functions.symbol: animation: ", "controller", "leave it out"),
    "empty file": ("", "name", "missing", "luxloop new"),
    "unknown road": (GOOD + '[road]\nkind = "bumpz"', "road.kind", "'bumpz'", "'bumps'"),
    "unknown lamp": (GOOD + '[headlight]\nlamps = ["lefft"]', "headlight.lamps[0]", "'left'"),
    "one lamp twice": (GOOD + '[headlight]\nlamps = ["left", "left"]', "headlight.lamps", "once"),
    "too short a vector": (
        GOOD + BOX.replace("[17, 0, 0]", "[17, 0]"),
        "objects[0].track[0].position_m[2]: is missing; write position_m = [20.0, 2.0, 0.0], say",
    ),
    "keyframes out of order": (
        GOOD + BOX.replace("[{", "[{time_s = 1, position_m = [0, 0, 0]}, {"),
        "objects[0]",
        "time_s must ascend",
    ),
    "future version": ("schema_version = 2" + GOOD, "schema_version", "version 1, not 2"),
    "long exposure": (GOOD + "[camera]\nexposure_s = 0.02", "camera.exposure_s", "half a control period", "0.01667", "rate_hz"),
    "limits the wrong way": (
        PID + "x_range_m = [40, 8]",
        "functions.symbol: controller.x_range_m",
        "40 must be less than 8",
    ),
    "a controller beside the functions": (LIT + '[controller]\nname = "open"', "controller: unknown key", "'pixel_controller'"),
    "no path": (
        LIT + '[functions.marker]\nkind = "path"',
        "functions.marker.control_m: is missing; write control_m = [[6.0, 0.0], [40.0, 3.0]], say",
    ),
    "more than all": (LIT + '[functions.own]\nkind = "width"\nvalue = 2', "functions.own: value: u_abs", "at most 1", "u_rel"),
    "a function's name": (
        LIT + '[functions."Own width"]\nkind = "width"',
        "functions.Own width: 'Own width' is not a valid name",
        "write own_width",
    ),
    "one name twice": (LIT + BOX + BOX, "objects", "'crate'", "rename"),
    "typo in a class": (
        LIT + '[functions.own]\nkind = "object_based"\nsetpoints_lx = { pedestrain = 3 }',
        "functions.own.setpoints_lx.pedestrain: 'pedestrain' is not possible",
        "'pedestrian'",
    ),
    "conditions out of order": (LIT + "[[conditions]]\ntime_s = 1\n[[conditions]]\ntime_s = 1", "conditions", "ascend"),
    "not TOML": ("name = snowflake", "not valid TOML", "line 1", "quotes"),
}


@pytest.mark.parametrize("wrong", BROKEN)
def test_broken_file_gives_one_sentence_with_file_key_and_remedy(file, wrong):
    text, *named = BROKEN[wrong]
    file.write_text(text)
    message = failure(file)
    assert message.startswith(str(file)) and all(part in message for part in named), message


def test_file_that_is_no_text(file):
    file.write_bytes(b'name = "M\xfcller"')
    assert "save it as UTF-8" in failure(file)
    file.write_bytes(bytes(range(256)))
    assert str(file) in failure(file)


def test_missing_file_folder_and_unknown_name(tmp_path):
    named = {"snowflak": "did you mean 'snowflake'?", tmp_path / "none.toml": "luxloop new", tmp_path: "folder", "zzzz": "luxloop list"}
    assert all(words in failure(name) for name, words in named.items())


SEVERAL = {
    "camera.bits": "9",
    "camera.widht_px": "1",
    "headlight.lamps[1]": '"lefft"',
    "light.ambient_lx": "2024-01-01",
    "rate_hz": '"x"',
    "road.kind": '"bumpz"',
}

MARKERS = '[functions.name]\nkind = "marker"\nanimation = { kind = "blinking" }\n[functions.kind]\nkind = "marker"\n'

OF_A_KIND = {
    PID: {"functions.symbol.controller.position.kp": '"x"', "functions.symbol.start.x_m": "[]", "functions.symbol.imag": "3"},
    LIT + MARKERS: {
        "functions.name.animation.rate_hz": '"x"',
        "functions.kind.kind": '"markr"',
        "tracker.zzz": "{}",
        "vehicel": "{}",
    },
}


@pytest.mark.parametrize(("text", "of_the_kind"), OF_A_KIND.items(), ids=("held", "functions"))
def test_all_errors_of_a_file_are_listed(text, of_the_kind, file):
    file.write_text('headlight.lamps = ["left", "right"]\n' + text + BOX)
    wrong = SEVERAL | of_the_kind
    with refusal(rf"^{file}.*: {len(wrong)} errors") as caught:
        load(str(file), [f"{key}={value}" for key, value in wrong.items()])
    lines = caught.value.args[1:]
    assert sorted(line.partition(": ")[0] for line in lines) == sorted(wrong) and all(map(is_one_sentence, lines))


def leaves(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for inner, each in items:
            yield from leaves(each, f"{key}.{inner}".strip(".") if isinstance(value, dict) else f"{key}[{inner}]")
    else:
        yield key, value


@pytest.mark.parametrize("name", scenario_files())
def test_each_key_that_is_broken_is_named(name):
    rng = random.Random(name)
    alone = (".kind", ".controller.name", "schema_version")  # others of the table, or of the file, mean nothing once they are wrong
    keys = [(key, value) for key, value in leaves(load(name).model_dump(mode="json")) if value is not None and not key.endswith(alone)]
    broken = {key: "3" if isinstance(value, str) else '"zzz"' for key, value in rng.sample(keys, 8)}
    with refusal(": ") as caught:
        load(name, [f"{key}={value}" for key, value in broken.items()])
    assert sorted(line.partition(": ")[0] for line in caught.value.args[1:]) == sorted(broken)


def test_a_class_with_a_dot_for_its_colon_is_told_how_to_be_written():
    named = {"functions.symbol.controller.name": "pi_ff.PiFeedForward", "detector.kind": "det.Blobs", "pixel_controller": "bold.Bold"}
    for key, name in named.items():
        assert (
            f"there is no {'pixel controller ' if key[0] == 'p' else ''}'{name}'; write {name.replace('.', ':')}, with a colon"
            in failure("flat", f"{key}={name}")
        )
    assert "write" not in failure("flat", "functions.symbol.controller.name=half.py")


@pytest.mark.parametrize(
    ("name", "override", "said"),
    [
        ("snowflake", "detector_frames=off", "detector_frames: there is no detector here"),
        ("snowflake", "detector_every=2", "detector_every: there is no detector here"),
        ("gfhb", "judge_causes=true", "judge_causes: there is no symbol with a controller and no detector here"),
        ("obl", "judge_projections=true", "judge_projections: there is no symbol on the road here"),
        ("obl", "detector_frames=off", "detector_frames: there is no symbol that a controller holds here"),
        ("obl", "off_share=0.3", "off_share: no controller holds a symbol here; leave it out"),
        ("obl", "disturbances.ambient=[{factor=2.0, frames='off'}]", "disturbances.ambient[0].frames: without a held symbol"),
        ("snowflake", "headlight.rate_hz=60", "headlight.rate_hz: the lamps draw anew for each frame, at 60 Hz"),
        ("driving", "headlight.rate_hz=250", "camera.exposure_s: the lamps draw anew at 250 Hz"),
        ("snowflake", "tracker.confirm_frames=5", "tracker: follows what a detector finds, but there is none"),
        ("night_traffic", "detector.kind=hog", "a detector knows only their class; --set functions.guide_line.names=[]"),
    ],
)
def test_what_means_nothing_without_something_else_is_told(name, override, said):
    assert said in failure(name, override)


def test_projections_without_an_evaluated_step_are_refused():
    for key in ("judge_causes", "judge_projections"):
        assert f"{key}: judge_every = 0 evaluates no step" in failure("snowflake", f"{key}=true", "judge_every=0")


DEEP, LONG = "[" * 3000 + "]" * 3000, "9" * 5000


@pytest.mark.parametrize("text", [f"steps = {DEEP}", f"steps = {LONG}", f"steps = 0x{LONG}", f"{'a.' * 3000}a = 1", f"['{'x' * 9999}']"])
def test_files_beyond_all_reason_are_told_in_a_sentence(text, file):
    file.write_text(text)
    assert len(failure(file)) < 1000
    with refusal(": "):
        load("flat", [text])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f'road.kind = "{"a" * 300}:Road"', "--allow-code"),
        ('road.kind = "\\u0000/a:Road"', "a text has a NUL character"),
        ('functions.symbol = {kind = "symbol", image = "\\u0000.png"}', "a text has a NUL character"),
    ],
)
def test_names_that_no_file_can_have_are_told_in_a_sentence(text, said, file):
    file.write_text(f'name = "mine"\n{text}')
    assert said in failure(file)
