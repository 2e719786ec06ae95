"""Other programs at the studio: a real server, and luxloop's own client."""

import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from luxloop import Client, connect, load, prepare
from luxloop.loop.recording.record import row
from luxloop.loop.studio.shared import BlockReader, Blocks
from tests.loop.studio.conftest import SMALL, Served
from tests.refusal import refusal

EXACT = ("frames", "depth", "instances", "materials", "truth")


def address(served: Served, token: str | None = None) -> str:
    return f"http://127.0.0.1:{served.port}/#{token or served.tokens.edit}"


@pytest.fixture
def client(served: Served) -> Iterator[Client]:
    """A program that steers, at step 0 of the scenario as it is shipped."""
    with connect(address(served)) as client:
        client.take_pen()
        client._ask("open", name="snowflake", overrides=list(SMALL))
        yield client


def test_steps_in_lockstep_are_those_of_the_command_line_bit_for_bit(client):
    frames = [client.want("frames").frames]
    frames += [client.step().frames for _ in range(5)]
    assert client.over and client.state.step == 5
    expected = list(prepare(load("snowflake", SMALL), "cpu").evaluations())
    for got, result in zip(frames, expected, strict=True):
        assert result.frames is not None
        assert all(np.array_equal(ours, theirs.numpy()) for ours, theirs in zip(got, result.frames, strict=True))
    table = client.rows()
    for name in ("functions.symbol.iou", "functions.symbol.x_m", "lamp.left.flux_lm"):
        assert np.array_equal(table[name], np.array([row(each)[name] for each in expected], np.float32))
        assert client.state.metrics[name] == table[name][-1]
    with refusal("all 6 steps are done"):
        client.step()


def test_what_a_pixel_sees_is_as_the_library_has_it(client):
    state = client.want(*EXACT)
    world = prepare(load("snowflake", SMALL), "cpu").world
    lit = world.lit(state.time_s)
    assert state.instances is not None and state.depth is not None and state.materials is not None
    assert np.array_equal(state.instances, lit.surfaces.object_id.numpy() + 1)
    assert state.instance_names[:2] == ["", "road"] and state.instances.max() < len(state.instance_names)
    assert state.material_names[state.materials[-1, 160]] and state.materials.shape == (180, 320)
    point = lit.surfaces.position[:, -1, 160].double() - lit.view.T_world_view[:3, 3]
    assert state.depth[-1, 160] == pytest.approx(float(point @ lit.view.T_world_view[:3, 2]), rel=1e-5)  # single precision
    assert np.array_equal(state.depth > 0, state.instances > 0)


def test_objects_are_told_with_their_boxes(client):
    walker = {"kind": "pedestrian", "name": "walker", "category": "pedestrian", "track": [{"position_m": [15.0, 0.0, 0.0]}]}
    client.set({"objects": [walker]})
    client.want(*EXACT)
    state = client.step()
    (found,) = state.objects
    assert found["category"] == "pedestrian" and state.instance_names[found["instance"]] == found["name"]
    rows, columns = np.nonzero(state.instances == found["instance"])
    assert tuple(found["box"]) == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    assert found["T_world_object"][3] == pytest.approx(15.0, abs=0.5) and found["size_m"][2] > 1.0


def test_light_and_utilisations_are_those_that_are_shown_and_nothing_is_made_that_nobody_wants(client, served):
    client.want("light", "matrix")
    state, run = client.step(), served.run
    for module, u in zip(run.simulation.modules, run.snapshots[-1].lights, strict=True):
        expected = module.headlight.light_texture(u).numpy()
        assert np.abs(state.light[module.name] - expected).max() <= expected.max() * 2**-10  # a half float has 11 bits
        assert np.array_equal(state.utilisations[module.name].flatten(), (255 * u).round().byte().numpy())
    client.want("truth")
    client.step()
    assert not run.snapshots[-1].exact and not run.snapshots[-1].pictures
    client.want("depth")
    client.step()
    assert run.snapshots[-1].exact and not run.snapshots[-2].exact


def test_raw_utilisations_are_shown_in_the_next_step_and_recorded_as_an_edit(client, served):
    module = client.facts["modules"][0]
    name, size = module["name"], (module["pixel_rows"], module["pixel_cols"])
    for share in (0.2, 0.6):
        client.show(name, np.full(size, share))
        assert (client.step().utilisations[name] == round(255 * share)).all()
    assert [each.step for each in served.run.tally.edits] == [1, 2]
    client.show(name, None)
    assert client.step().utilisations[name].min() == 0
    for wrong, picture, words in (("middle", np.zeros(size), "there is no module 'middle'"), (name, np.zeros((2, 2)), "pixels")):
        with refusal(words):
            client.show(wrong, picture)


def test_modules_are_commanded(client):
    client._ask("open", name="flat", overrides=[*SMALL, "functions.symbol={}", "headlight.model=ssl-hd"])
    for command, expected in (
        ({"swivel_deg": 5.0, "intensity": 0.5}, {"swivel_deg": 5.0, "intensity": 0.5}),
        ({"level_deg": 1.0}, {"swivel_deg": 0.0, "level_deg": 1.0}),
    ):
        client.command("left hires", **command)
        metrics = client.step().metrics
        assert {key: metrics[f"modules.left hires.{key}"] for key in expected} == expected


def test_who_runs_freely_gets_the_newest_and_the_last(client):
    client.set({"steps": 60})
    client.want("matrix")
    client.play()
    seen = []
    for state in client:
        seen.append(state.step)
        time.sleep(0.3)
    assert seen == sorted(set(seen)) and seen[-1] == 59 and len(seen) < 59
    assert len(client.rows()["functions.symbol.iou"]) == 60 and not client.playing
    client.reset()
    assert client.state.step == 0 and not client.over


def test_errors_are_raised_and_watchers_change_nothing(client, served, monkeypatch):
    for changes, words in (
        ({"camera.bitz": 8}, "did you mean 'bits'"),
        ({"headlight.model": "/etc/passwd"}, "names a file"),
        ({f"functions.f{k}": None for k in range(101)}, "at most 100 items"),
        ({"name": "x" * 2**21}, "its head has"),  # so that nobody reads its `ask`
    ):
        with refusal(words):
            client.set(changes)
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:1")
    with connect(address(served, served.tokens.watch), views=("truth",)) as watcher:
        assert watcher.role == "watch"
        for change in (watcher.step, watcher.play, watcher.reset, watcher.take_pen, lambda: watcher.set({"steps": 8})):
            with refusal("lets you watch"):
                change()
        step = client.step().step
        watcher._wait(lambda: watcher._got.state is not None and watcher._got.state.step == step)
        assert watcher.scenario["name"] == "snowflake"
    for place, words in (
        (address(served, "guess"), "not of this studio"),
        ("http://127.0.0.1:8765/", "no address of a studio"),
        ("http://127.0.0.1:1/#token", "no studio answers"),
    ):
        with refusal(words):
            connect(place)


def blocks() -> set[str]:
    """Shared memory of studios that is there."""
    return {each.name for each in Path("/dev/shm").glob("luxloop_*")}


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="lists shared memory as Linux does")
def test_memory_has_what_the_socket_brings_and_goes_with_the_client(client, served):
    views = ("light", "matrix", *EXACT)
    client.want(*views)
    others = blocks()
    with connect(address(served, served.tokens.watch), views=views, shared=True) as watcher:
        for _ in range(4):
            state = client.step()
            there = watcher._wait_for(lambda there, step=state.step: there.step == step)
            assert "shared" in there.head and "shared" not in state.head
            for one, other in ((state.light, there.light), (state.utilisations, there.utilisations), (state.arrays, there.arrays)):
                assert one.keys() == other.keys() and one
                assert all(np.array_equal(one[name], other[name]) and one[name].dtype == other[name].dtype for name in one)
        assert len(blocks() - others) == 2
        data = Path("/dev/shm", there.head["shared"]["block"]).read_bytes()
        assert struct.unpack_from("<8sIIQ", data) == (b"LUXLOOP\0", 1, 64, there.head["id"])
        told = there.head["shared"]["arrays"]["depth"]
        depth = np.frombuffer(data, "<f4", told["bytes"] // 4, told["start"]).reshape(told["shape"])
        assert np.array_equal(depth, state.depth)
    end_s = time.monotonic() + 20  # in which a server has seen that a client is gone
    while blocks() != others and time.monotonic() < end_s:
        time.sleep(0.02)
    assert blocks() == others


def test_who_reads_too_late_is_told_so():
    written, mapped = Blocks(), BlockReader()
    try:
        first = written.put(0, 1, {"a": np.arange(6, dtype=np.float32)})
        second = written.put(0, 2, {"a": np.arange(6, dtype=np.float32) + 1})
        assert first is not None and second is not None and first["block"] != second["block"]
        found = mapped.arrays(first, 1)
        assert found is not None and np.array_equal(found["a"], np.arange(6))
        written.put(0, 3, {"a": np.zeros(6, np.float32)})
        assert mapped.arrays(first, 1) is None
        larger = written.put(0, 4, {"a": np.zeros(10_000, np.float32)})
        assert larger is not None and larger["block"] != second["block"] and mapped.arrays(second, 2) is None
        other, next_ = (written.put(1, number, {"a": np.zeros(6, np.float32)}) for number in (5, 7))  # beside another run
        assert other is not None and next_ is not None and other["block"] != next_["block"]
    finally:
        mapped.close()
        written.close()
    assert written.put(0, 5, {}) is None


def test_memory_is_shared_with_this_machine_alone(client, served, monkeypatch):
    for each in served.studio._clients:
        monkeypatch.setattr(each, "is_here", False)
    with refusal("same machine"):
        client._ask("want", views=[], shared=True)
