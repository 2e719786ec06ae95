"""Registered data: found, fetched from a server on this machine, refused when it is not what it should be."""

import hashlib
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from luxloop.loop.scenario import data
from luxloop.loop.scenario.data import DataFile
from luxloop.world.errors import LuxloopError

CONTENT = b"$ROAD_CRG\r\n\x00\xff a scan\n"
REAL = data.registry()


@pytest.fixture(autouse=True)
def nothing_at_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine that has fetched nothing yet; returns its cache folder."""
    monkeypatch.delenv(data.FOLDER_VARIABLE, raising=False)
    monkeypatch.delenv(data.MIRROR_VARIABLE, raising=False)
    monkeypatch.setattr(data, "cache_folder", lambda: tmp_path / "cache")
    return tmp_path / "cache"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    """Address of a server that has one road."""
    root = tmp_path / "server"
    (root / "roads").mkdir(parents=True)
    (root / "roads" / "setts.crg").write_bytes(CONTENT)

    class Quiet(SimpleHTTPRequestHandler):
        def __init__(self, *args: object) -> None:
            super().__init__(*args, directory=str(root))

        def log_message(self, *_: object) -> None:
            pass

    httpd = ThreadingHTTPServer(("127.0.0.1", 0), Quiet)
    thread = threading.Thread(target=httpd.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{httpd.server_port}"
    httpd.shutdown()
    httpd.server_close()
    thread.join()


def known(url: str = "http://127.0.0.1:9", content: bytes = CONTENT, file: str = "roads/setts.crg") -> dict[str, DataFile]:
    sha256 = hashlib.sha256(content).hexdigest()
    return {"setts": DataFile("setts", file, "road", "stones", "Apache-2.0", len(content), sha256, f"{url}/{file}")}


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_fetched_once_then_found(server: str, nothing_at_hand: Path) -> None:
    files_known = known(server)
    with pytest.raises(LuxloopError, match="`luxloop data get setts`"):
        data.find("setts", files_known)
    first = data.get("setts", known=files_known)
    assert first.downloaded and first.path == nothing_at_hand / "roads" / "setts.crg"
    assert first.path.read_bytes() == CONTENT
    again = data.get("setts", known=files_known)
    assert not again.downloaded and again.path == first.path == data.find("setts", files_known)
    assert files(nothing_at_hand) == [first.path]


def test_a_mirror_stands_in_for_the_source(server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = data.get("setts", directory=tmp_path / "mine", base_url=server + "/", known=known()).path
    assert path == tmp_path / "mine" / "roads" / "setts.crg"
    monkeypatch.setenv(data.MIRROR_VARIABLE, server)
    assert data.get("setts", known=known()).downloaded
    # The folder given is one that LUXLOOP_DATA may name.
    monkeypatch.setenv(data.FOLDER_VARIABLE, str(tmp_path / "mine"))
    assert data.find("setts", known()) == path


@pytest.mark.parametrize("place", ["roads/setts.crg", "setts.crg"])
def test_copies_at_hand_come_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    copy = tmp_path / "own" / place
    copy.parent.mkdir(parents=True)
    copy.write_bytes(CONTENT)
    monkeypatch.setenv(data.FOLDER_VARIABLE, str(tmp_path / "own"))
    assert data.find("setts", known()) == copy
    assert data.get("setts", known=known()) == data.Fetched(copy, downloaded=False)  # its address leads nowhere


def test_another_content_is_refused_and_not_kept(server: str, nothing_at_hand: Path, tmp_path: Path) -> None:
    with pytest.raises(LuxloopError, match=r"SHA-256 differs"):
        data.get("setts", known=known(server, content=b"something else"))
    assert files(nothing_at_hand) == []
    spoilt = tmp_path / "mine" / "roads" / "setts.crg"
    spoilt.parent.mkdir(parents=True)
    spoilt.write_bytes(b"spoilt")
    assert data.get("setts", directory=tmp_path / "mine", known=known(server)).downloaded
    assert spoilt.read_bytes() == CONTENT


def test_what_has_changed_since_it_was_fetched_is_fetched_again(server: str) -> None:
    path = data.get("setts", known=known(server)).path
    path.write_bytes(b"spoilt")
    assert data.get("setts", known=known(server)) == data.Fetched(path, downloaded=True)
    assert path.read_bytes() == CONTENT


def test_a_changed_copy_of_the_users_is_refused_and_left_alone(server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy = tmp_path / "setts.crg"
    copy.write_bytes(b"mine")
    monkeypatch.setenv(data.FOLDER_VARIABLE, str(tmp_path))
    with pytest.raises(LuxloopError, match=r"setts\.crg: is not 'setts' as registered \(SHA-256 differs\); move it away"):
        data.get("setts", known=known(server))
    assert copy.read_bytes() == b"mine"


def test_what_the_server_lacks(server: str, nothing_at_hand: Path) -> None:
    with pytest.raises(LuxloopError, match=r"none\.crg cannot be fetched: 404 .* save it by hand as .*none\.crg"):
        data.get("setts", known=known(server, file="roads/none.crg"))
    assert files(nothing_at_hand) == []


def test_no_network(nothing_at_hand: Path) -> None:
    with pytest.raises(LuxloopError, match=r"cannot be reached; connect .* LUXLOOP_DATA to a folder with roads/setts\.crg"):
        data.get("setts", known=known())  # port 9: nobody listens
    assert files(nothing_at_hand) == []


def test_a_folder_that_cannot_be_written(server: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LuxloopError, match=r"cannot be written .* --dir"):
        data.get("setts", directory=tmp_path / "file", known=known(server))


def test_names(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(LuxloopError, match="did you mean 'belgian_block'"):
        data.find("belgian_blocks")
    with pytest.raises(LuxloopError, match="did you mean 'Barber'"):
        data.find("barber")
    with pytest.raises(LuxloopError, match="`luxloop data list` shows all"):
        data.find("xyzzy")
    assert data.locate("roads/own.crg") == Path("roads/own.crg")
    with pytest.raises(LuxloopError, match="luxloop data get belgian_block"):
        data.locate("belgian_block")
    monkeypatch.setenv(data.FOLDER_VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(LuxloopError, match=r"LUXLOOP_DATA names .*nowhere, which is not a folder"):
        data.find("belgian_block")


def test_rows(server: str) -> None:
    (row,) = data.rows(known(server))
    assert (row.name, row.kind, row.licence, row.bytes, row.path) == ("setts", "road", "Apache-2.0", len(CONTENT), None)
    path = data.get("setts", known=known(server)).path
    assert data.rows(known(server))[0].path == path


def test_the_registry_pins_every_source() -> None:
    assert {each.kind for each in REAL.values()} == {"road", "photometric"}
    for each in REAL.values():
        assert each.name == Path(each.file).stem and len(each.sha256) == 64
        # A 40-digit commit in the address: a branch would move under the SHA-256.
        assert each.url.startswith("https://raw.githubusercontent.com/") and len(each.url.split("/")[5]) == 40
        assert each.url.endswith("/" + Path(each.file).name)


def test_registry_agrees_with_copies_at_hand(data_dir: Path) -> None:
    copies = [each for each in REAL.values() if (data_dir / each.file).is_file()]
    assert copies
    for each in copies:
        content = (data_dir / each.file).read_bytes()
        assert (len(content), hashlib.sha256(content).hexdigest()) == (each.bytes, each.sha256), each.name
