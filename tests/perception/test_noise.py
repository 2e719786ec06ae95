"""The noise of frames: the same bits in any part, the distribution it says, and nothing that repeats."""

import hashlib
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from luxloop.perception.noise import GOLDEN, PARTS, FrameNoise, tables

HEIGHT, WIDTH = 1000, 1000
N = HEIGHT * WIDTH
WHOLE = slice(0, HEIGHT), slice(0, WIDTH)
SIGMAS = 5  # that an estimate may be off by, of its own standard error: some 1 in 2 million for each


def drawn(seed: int = 1, step: int = 0, frame: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return FrameNoise.of(seed, step, frame).part(WHOLE, torch.empty(0, dtype=dtype))


def splitmix64(state: int) -> int:
    """The published algorithm in whole numbers: the next output of a generator in a state."""
    most = 2**64 - 1
    state = (state + GOLDEN) & most
    state = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & most
    state = ((state ^ (state >> 27)) * 0x94D049BB133111EB) & most
    return state ^ (state >> 31)


@given(key=st.integers(0, 2**64 - 1), v=st.integers(0, 8191), u=st.integers(0, 8191))
def test_integers_are_splitmix64s(key, v, u):
    (bits,) = FrameNoise(key).integers((slice(v, v + 1), slice(u, u + 1))).flatten().tolist()
    counter = (v << 32) + u // 2
    assert bits % 2**32 == splitmix64((key + counter * GOLDEN) % 2**64) >> 32 * (u % 2) & 2**32 - 1


def test_published_outputs_are_met():
    """Of the generator with the seed 1234567, as its reference implementation prints them."""
    first = FrameNoise(1234567).integers((slice(0, 1), slice(0, 6))).view(torch.int64).flatten().tolist()
    assert [each % 2**64 for each in first] == [6457827717110365317, 3203168211198807973, 9817491932198370423]


@given(top=st.integers(0, 900), left=st.integers(0, 900), height=st.integers(0, 99), width=st.integers(0, 99))
def test_a_part_has_the_bits_of_the_whole(top, left, height, width):
    part = slice(top, top + height), slice(left, left + width)
    noise, like = FrameNoise.of(3, 5, 1), torch.empty(0)
    assert torch.equal(noise.part(part, like), noise.part((slice(0, HEIGHT), slice(0, WIDTH)), like)[part])


def test_the_hosts_form_has_the_bits_of_the_table():
    """In a part with both tails: one pixel in 32,768 lies in them."""
    noise, part = FrameNoise.of(2, 7, 0), (slice(3, 700), slice(5, 1000))
    middle, sign, tail = tables(torch.float32, torch.device("cpu"))
    bits = noise.integers(part).long()
    place, further = bits >> 16 & PARTS - 1, bits & PARTS - 1
    assert {0, PARTS - 1} <= set(place.flatten().tolist())
    assert torch.equal(noise.part(part, torch.empty(0)), middle[place] + sign[place] * tail[further])


def test_devices_and_types_give_the_same_numbers(device):
    exact = drawn()
    assert torch.equal(drawn(dtype=torch.float32), exact.float())
    assert torch.equal(FrameNoise.of(1, 0, 0).part(WHOLE, torch.empty(0, dtype=torch.float64, device=device)).cpu(), exact)


def test_numbers_stay_as_they_are():
    """Another machine, another torch: recordings hold what these numbers make of them."""
    assert hashlib.sha256(drawn(1, 2, 1, torch.float32).numpy().tobytes()).hexdigest()[:16] == "db8abf494752843b"


@pytest.mark.parametrize("power", [1, 2, 3, 4, 6])
def test_moments_are_those_of_the_normal_distribution(power):
    def moment(n: int) -> int:
        return 0 if n % 2 else math.prod(range(1, n, 2))

    error = math.sqrt((moment(2 * power) - moment(power) ** 2) / N)
    assert abs(float((drawn() ** power).mean()) - moment(power)) < SIGMAS * error


@pytest.mark.parametrize(
    "other", [(1, 0, 1), (1, 1, 0), (2, 0, 0), (1, 2**20, 0)], ids=["the other frame", "the next step", "the next seed", "a late step"]
)
def test_frames_are_independent(other):
    one, two = drawn(), drawn(*other)
    assert abs(float((one * two).mean())) < SIGMAS / math.sqrt(N)
    assert abs(float(((one**2 - 1) * (two**2 - 1)).mean())) < SIGMAS * 2 / math.sqrt(N)


@pytest.mark.parametrize("z", [0.01, 0.5, 1.0, 2.0, 3.0, 4.0, 4.5])
def test_as_much_lies_beyond_as_should(z):
    p = math.erfc(z / math.sqrt(2))
    beyond = float((drawn().abs() > z).sum())
    assert abs(beyond - N * p) < SIGMAS * math.sqrt(N * p * (1 - p)) + 1  # counts are whole
