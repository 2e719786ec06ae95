"""Who is let in, who may do what, and what clients get."""

import random
import socket
import threading
import time
import urllib.error
import urllib.request
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from studio_answers import ANSWERS, PARTS
from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.uri import parse_uri

import luxloop
from luxloop.loop.recording.record import row
from luxloop.loop.studio.messages import VIEWS, Button, Request, View
from luxloop.loop.studio.server import ASLEEP_S, MOST_ASKED
from luxloop.loop.studio.session import SessionState
from luxloop.loop.studio.sources import refuse_foreign
from luxloop.loop.studio.stream import Stream
from tests.loop.studio.clients import message, unpacked, watching
from tests.loop.studio.conftest import SMALL, Served


def fetched(served: Served, path: str, **headers: str) -> tuple[int, bytes]:
    request = urllib.request.Request(f"http://127.0.0.1:{served.port}{path}", headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def test_the_page_is_served_and_nothing_beside_it(served):
    for host in (f"192.168.1.5:{served.port}", f"LOCALHOST:{served.port}", "[::1]", "127.0.0.1"):
        assert fetched(served, "/", Host=host) == (200, b"<!doctype html><title>studio</title>")
    for path in ("/secret.key", "/../conftest.py", "/%2e%2e/conftest.py", "/etc/passwd", "/none.js"):
        assert fetched(served, path)[0] == 404


def test_other_hosts_and_origins_are_forbidden(served):
    for host in ("evil.example", "evil.example:80", "[::1"):
        assert fetched(served, "/", Host=host)[0] == 403
    for origin in ("http://evil.example", "null"):
        assert fetched(served, "/", Origin=origin)[0] == 403
        with pytest.raises(InvalidStatus):
            connect(f"ws://127.0.0.1:{served.port}/socket", origin=origin)


@pytest.mark.parametrize("first", [message(type="hello", token="guess"), message(type="play"), b"\0", "hello"])
def test_without_a_token_nothing_is_told(served, first):
    with connect(f"ws://127.0.0.1:{served.port}/socket") as socket:
        socket.send(first)
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(20)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 4401


def test_a_client_gets_the_run_and_the_values_of_the_command_line(served):
    with watching(served.port, served.tokens.edit) as watcher:
        head, _ = watcher.of("scenario")
        assert head["name"] == "snowflake" and head["steps"] == 6
        meshes, arrays = watcher.of("meshes")
        road = next(each["id"] for each in meshes["meshes"] if each["kind"] == "road")
        vertices, faces = arrays[f"{road}.vertices"], arrays[f"{road}.faces"]
        assert vertices.shape[1] == 3 and faces.max() < len(vertices) and f"{road}.texture" in arrays
        watcher.say("play")
        watcher.of("status", playing=False, failed=None)
        watcher.of("step", step=5)
        rows = np.concatenate([arrays["rows"] for head, arrays in watcher.got if head["type"] == "rows"])
        names = [each["name"] for each in head["runs"][0]["columns"]]
        assert all(ANSWERS[each["type"]].keys() <= each.keys() for each, _ in watcher.got)
        assert PARTS["Run"].keys() == head["runs"][0].keys() and PARTS["Module"].keys() == head["runs"][0]["modules"][0].keys()
    expected = [row(result) for result in luxloop.prepare(luxloop.load("snowflake", SMALL), "cpu").evaluations()]
    assert len(rows) == len(expected)
    for name in ("functions.symbol.iou", "functions.symbol.x_m", "lamp.left.flux_lm"):
        assert np.array_equal(rows[:, names.index(name)], np.array([each[name] for each in expected], np.float32))


def test_light_that_is_the_same_is_not_sent_again(served, editor):
    editor.say("pause", ask=1)
    editor.of("done", ask=1)  # and so is all that was asked before
    published, feed = served.studio.session.state, Stream()

    def step(**seen: Any) -> dict[str, Any]:
        *_, last = (unpacked(each)[0] for each in feed.messages(published, Request(at=(0, 0), **seen)))
        return last

    first = step()
    assert "0" in first["light_windows"]
    snapshots = served.run.snapshots
    snapshots[0] = replace(snapshots[0], lights=tuple(u.clone() for u in snapshots[0].lights))
    again = step(shown=first["id"])
    assert again["type"] == "step" and again["light_windows"] == {}


def test_messages_rest_while_the_session_plays_and_come_at_once_when_it_stops(served, editor, monkeypatch):
    editor.reset()
    monkeypatch.setattr("luxloop.loop.studio.stream.REST", 1e9)
    rested, playing = Stream(), replace(served.studio.session.state, playing=True)
    assert "step" in kinds(rested, playing)
    began_s = time.monotonic()
    monkeypatch.setattr("luxloop.loop.studio.stream.LONGEST_REST_S", 3600.0)
    feed = Stream()
    assert "step" in kinds(feed, playing)
    served.studio.session.ask(Button(type="step"), print)
    while len(playing.runs[0].snapshots) < 2:
        time.sleep(0.01)
    assert kinds(feed, playing, shown=9) == []
    assert "step" in kinds(feed, playing, at=(0, 0), shown=9)  # who looks back does not wait
    assert kinds(feed, replace(playing, playing=False), shown=9) == ["step"]
    time.sleep(max(began_s + 0.3 - time.monotonic(), 0))
    assert "step" in kinds(rested, playing, shown=9), "however long the messages took that came last"


def test_a_step_that_a_rest_held_back_comes_at_its_end(editor, monkeypatch):
    monkeypatch.setattr("luxloop.loop.studio.stream.REST", 1e9)
    monkeypatch.setattr("luxloop.loop.studio.stream.LONGEST_REST_S", 1.0)
    editor.reset()
    editor.of("step", step=0)
    editor.say("speed", factor=0.002)  # 17 s from one step to the next
    editor.say("play")
    assert editor.of("step")[0]["step"] == 1
    editor.say("pause")
    editor.say("speed", factor=None)


def test_the_newest_step_follows_once_the_one_on_its_way_is_shown(served, editor):
    editor.reset()
    feed, state = Stream(), served.studio.session.state
    (first,) = (head for head in sent(feed, state) if head["type"] == "step")
    editor.step(1, 2)
    state = served.studio.session.state
    assert [head["type"] for head in sent(feed, state)] == ["rows"]
    (second,) = sent(feed, state, shown=first["id"])
    assert second["step"] == 2


def test_the_frame_without_the_symbol_is_computed_and_sent_for_who_shows_it(served, editor):
    editor.reset()
    _, arrays = editor.of("step", step=0)
    assert [name for name in arrays if name.startswith("camera.")] == ["camera.on"]
    editor.step(1)
    _, off = served.run.highlights.moments[-1].frames
    assert off.known != (slice(0, 180), slice(0, 320)), "the controller reads a part"
    editor.say("want", views=["camera", "off", "symbol"])
    _, arrays = editor.until(lambda head: "camera.off" in head.get("arrays", {}))  # at rest
    assert {"camera.on", "camera.off", "camera.symbol"} == arrays.keys()
    assert not np.array_equal(arrays["camera.on"], arrays["camera.off"])
    editor.say("play")
    editor.of("status", playing=False)
    assert "camera.off" in served.run.snapshots[-1].pictures
    editor.say("want", views=VIEWS)


def sent(feed: Stream, published: SessionState, **request: Any) -> list[dict[str, Any]]:
    """Heads of messages."""
    return [unpacked(each)[0] for each in feed.messages(published, Request(**request))]


def kinds(feed: Stream, published: SessionState, **request: Any) -> list[str]:
    return [head["type"] for head in sent(feed, published, **request)]


def test_who_does_not_read_is_let_go(served, monkeypatch):
    monkeypatch.setattr("luxloop.loop.studio.server.DEAF_S", 0.5)
    with watching(served.port, served.tokens.edit) as watcher, socket.socket() as deaf:
        watcher.of("scenario")
        (listening,) = served.server.sockets
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)  # so that what is sent does not fit the system's buffers
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect(("127.0.0.1", served.port))
        there = ClientProtocol(parse_uri("ws://127.0.0.1/socket"))
        there.send_request(there.connect())
        deaf.sendall(b"".join(there.data_to_send()))
        there.receive_data(deaf.recv(4096))
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2**20)  # for all later clients: the system adapts it no longer
        there.send_binary(message(type="hello", token=served.tokens.watch))
        deaf.sendall(b"".join(there.data_to_send()))
        watcher.of("status", clients=2)
        watcher.of("status", clients=1)


def test_a_step_can_be_seen_again_is_not_overtaken_and_a_new_start_is_followed(editor):
    editor.reset()
    shown, _ = editor.of("step", step=0)
    editor.step(1, 2)
    editor.say("scrub", run=0, step=0)
    again, arrays = editor.of("step", step=0, scrub=True)
    assert again["symbols"] == shown["symbols"] and "light.0" in arrays
    editor.say("step")
    editor.of("rows", first=3)
    editor.say("scrub", step=None)
    assert editor.of("step")[0]["step"] == 3
    editor.say("scrub", run=0, step=0)
    editor.of("step", scrub=True)
    editor.reset()
    editor.say("scrub", step=None)
    editor.say("step")
    editor.of("step", step=1, scrub=False)


def test_values_that_are_no_files_may_have_dots():
    refuse_foreign(
        ['name="v1.2"', 'checks.c={metric="functions.symbol.iou", at_least=0.1}', "functions.symbol.image=chevrons", "road.kind=bumps"]
    )


def test_watchers_cannot_write_and_one_holds_the_pen(served):
    with watching(served.port, served.tokens.edit) as editor, watching(served.port, served.tokens.watch) as watcher:
        assert editor.of("welcome")[0]["role"] == "edit" and watcher.of("welcome")[0]["role"] == "watch"
        watcher.of("scenario")
        before = served.studio.session.state
        for head in (
            *({"type": kind} for kind in ("pen", "play", "pause", "step", "reset", "undo", "redo", "save")),
            *({"type": "record", "folder": "mine"}, {"type": "speed", "factor": 1}, {"type": "set", "overrides": ["camera.bits=8"]}),
            *({"type": "open", "name": "flat"}, {"type": "compare", "overrides": []}),
        ):
            watcher.say(**head)
            assert "watch" in watcher.of("error")[0]["text"]
        assert served.studio.session.state is before
        with watching(served.port, served.tokens.edit) as second:
            second.say("pause")
            assert "pen" in second.of("error")[0]["text"]
            second.say("pen")
            second.of("status", pen=second.got[0][0]["id"])


FOREIGN = {
    "detector.kind=os:system": "module of Python",
    "headlight.model=/etc/passwd": "names a file",
    "functions.symbol.image=../../x.svg": "names a file",
    "keys.toml": "cannot name a file",
    "plant.kind=simulated": "plant",
    "detector={kind='network', weights='mine'}": "names a file",
    'objects=[{kind="mesh", file="/dev/zero"}]': "names a file",
}


def test_the_page_cannot_name_files_and_code(served, editor):
    before = served.studio.session.state.number
    for override, words in FOREIGN.items():
        for kind in ("set", "compare"):
            editor.say(kind, overrides=[override])
            assert words in editor.of("error", about=kind)[0]["text"]
    for source in ({"name": "/etc/passwd"}, {"recording": "/tmp"}):
        editor.say("open", **source)
        editor.of("error", about="open")
    assert served.studio.session.state.number == before


def test_a_wrong_value_is_answered_as_on_the_command_line_and_changes_nothing(served, editor):
    before = served.studio.session.state.runs
    editor.say("set", overrides=["camera.bitz=8"])
    assert "camera.bitz: unknown key; did you mean 'bits'?" in editor.of("error", about="set")[0]["text"]
    editor.say("beam", rule="r1", side="left")
    assert "r1" in editor.of("error", about="beam")[0]["text"]
    editor.say("beam", rule="r149-passing-c", side="left")
    points = editor.of("beam")[0]["points"]
    assert {True, False} <= {each["passed"] for each in points}  # a symbol alone is no passing beam, but dazzles nobody
    assert served.studio.session.state.runs == before


def test_a_watcher_may_ask_for_the_schema_which_has_every_key_of_the_model(served):
    with watching(served.port, served.tokens.watch) as watcher:
        scenario, _ = watcher.of("scenario")
        watcher.say("schema")
        schema = watcher.of("schema")[0]["schema"]
        assert schema["properties"].keys() == scenario["model"].keys()
        gain = schema["$defs"]["PidTuning"]["properties"]["kp"]
        assert gain["description"] == "proportional gain" and gain["minimum"] < gain["maximum"]


@pytest.mark.parametrize("count", [500, pytest.param(10_000, marks=pytest.mark.slow)])
def test_damaged_messages_change_nothing_and_end_nothing(served, count):
    rng = random.Random(0)
    picture = {name: np.full((20, 30), 7, np.uint8) for name in ("value", "painted")}
    good = [message(type="want", views=["scene"]), message(type="scrub", run=0, step=2), message(type="beam", rule="r149-passing-c")]
    good += [message(type="place", point_m=[20, 0, 0], value=9)]
    good += [message(picture, coding, type="paint", module=0, box=[0, 20, 0, 30]) for coding in ("raw", "deflate", "png")]
    with watching(served.port, served.tokens.watch) as watcher:
        watcher.of("scenario")
        before = served.studio.session.state
        for number in range(count):
            data = bytearray(rng.choice(good))
            for _ in range(rng.randint(1, 8)):
                data[rng.randrange(len(data))] = rng.randrange(256)
            watcher.socket.send(bytes(data[: rng.randint(0, len(data))] if rng.random() < 0.3 else data))
            if number % 50 == 49:  # who does not read answers is not read
                watcher.say("play")
                watcher.until(lambda head: head["type"] == "error" and head["text"].startswith("play"))
        assert served.studio.session.state is before


def test_a_client_that_does_not_read_does_not_slow_the_loop(served, editor):
    with connect(f"ws://127.0.0.1:{served.port}/socket", max_size=None, max_queue=1) as deaf:
        deaf.send(message(type="hello", token=served.tokens.watch))
        for _ in range(3):  # after the first the deaf client's messages are stuck
            editor.reset()
            editor.say("play")
            began_s = time.monotonic()
            editor.of("status", playing=False)
            assert len(served.run.rows) == 6
            assert time.monotonic() - began_s < 60  # six steps take seconds; a loop that waits for who is deaf takes for ever


def test_no_picture_is_taken_for_a_client_that_does_not_show_its_steps(served, editor):
    editor.reset()
    _, arrays = editor.of("step", step=0)
    assert "camera.on" in arrays
    editor.say("want", views=[])
    with watching(served.port, served.tokens.watch) as hidden:
        hidden.say("want", views=["camera"], ask=1)
        hidden.of("done", ask=1)
        editor.say("step")
        while unpacked(last := hidden.socket.recv(20))[0]["type"] != "step":
            pass
        time.sleep(1.1 * ASLEEP_S)
        editor.step(2)  # notices that it is asleep
        editor.step(3)
        assert served.run.snapshots[-1].pictures == {}
        hidden.say("shown", id=unpacked(last)[0]["id"])
        head, arrays = hidden.until(lambda head: head["type"] == "step" and "camera" in head["views"])
        assert head["step"] == 3 and "camera.on" in arrays  # at rest it is taken again
    editor.say("want", views=VIEWS)


def test_a_client_that_wakes_waits_for_a_step_with_what_it_shows(served, editor):
    editor.reset()
    feed, state = Stream(), replace(served.studio.session.state, playing=True)
    assert "step" in kinds(feed, state)
    blind = replace(state.runs[0].snapshots[-1], views=frozenset[View](), pictures={})
    state.runs[0].snapshots.append(blind)
    assert kinds(feed, state, shown=9) == []
    assert "step" in kinds(feed, replace(state, playing=False), shown=9), "nothing better comes"
    editor.reset()


def test_what_a_client_asks_waits_on_its_side_while_the_session_is_busy(served, monkeypatch):
    session, goes_on = served.studio.session, threading.Event()
    with watching(served.port, served.tokens.watch) as watcher:
        watcher.of("scenario")
        monkeypatch.setattr(session, "_do", lambda asked: goes_on.wait(20))
        for run in range(300):
            watcher.say("summary", run=run, ask=run)
        deadline_s = time.monotonic() + 10
        while session.waiting <= MOST_ASKED and time.monotonic() < deadline_s:
            time.sleep(0.05)
        time.sleep(0.3)  # in which all would come
        assert session.waiting == MOST_ASKED + 1
        goes_on.set()
        assert [watcher.of("done")[0]["ask"] for _ in range(300)] == list(range(300))


def test_answers_do_not_pile_up_for_a_client_that_does_not_read(served):
    rays, count = [[10 + 0.01 * k, 0, 0] for k in range(3000)], 30
    with watching(served.port, served.tokens.watch) as watcher:
        watcher.of("scenario")  # is prepared
    with connect(f"ws://127.0.0.1:{served.port}/socket", max_size=None, max_queue=1) as deaf:
        deaf.send(message(type="hello", token=served.tokens.watch))
        for _ in range(count):  # answers of 1 MB, of which sockets hold some
            deaf.send(message(type="meter", eye_m=[0, 0, 1.2], through_m=rays))
            time.sleep(0.4)  # in which a busy machine answers
        heads, last = [], "schema"
        deaf.send(message(type=last))
        while not heads or heads[-1]["type"] != last:
            heads.append(unpacked(deaf.recv(60))[0])
        refused = [each["text"] for each in heads if each["type"] == "error"]
        assert all("not answered yet" in each for each in refused)
        assert len(refused) + sum(each["type"] == "meter" for each in heads) == count
        assert len(refused) > count / 2
