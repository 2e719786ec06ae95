"""Structured light tells where a lamp's pixels are seen, and smooth maps go both ways."""

import numpy as np

from luxloop.loop.rig.arrays import Array
from luxloop.loop.rig.calibration.structured_light import Chart, decode, patterns, places

ROWS, COLS = 36, 50
SCALE, OFF = 2.3, 7.4  # camera pixels a lamp pixel, and where the lamp's light begins


def pictures(noise: float) -> tuple[list[Array], Array, Array]:
    """Light of all patterns in a camera of 120 x 150 px that sees blurred pixels, and the true lamp coordinates of its pixels."""
    v, u = np.indices((120, 150)) + 0.5
    row, col = (v - OFF) / SCALE, (u - OFF) / (SCALE * (1 + 2e-4 * u))
    rng = np.random.default_rng(0)
    along = [np.clip(0.9 - np.abs(at.ravel()[:, None] - np.arange(n) - 0.5), 0, 0.8) / 0.8 for at, n in ((row, ROWS), (col, COLS))]
    found = []
    for _, u in patterns(ROWS, COLS):
        image = np.einsum("nr,rc,nc->n", along[0], u.reshape(ROWS, COLS), along[1]).reshape(row.shape)
        found.append(0.1 + image + noise * rng.standard_normal(row.shape))
    return found, row, col


def test_each_camera_pixel_reads_its_place_and_centres_follow():
    light, row, col = pictures(0.01)
    read_row, read_col, valid = decode(light, ROWS, COLS, 0.01)
    inside = (row > 0.7) & (row < ROWS - 0.7) & (col > 0.7) & (col < COLS - 0.7)
    assert valid[inside].mean() > 0.99
    assert not valid[(row < -0.5) | (col < -0.5) | (row > ROWS + 0.5) | (col > COLS + 0.5)].any()
    # Within a sharp pixel the phase hardly changes, so that a reading is wrong by half a pixel at most, and right in the mean.
    for read, true in ((read_row, row), (read_col, col)):
        off = (read - true)[inside & valid]
        assert np.abs(off).max() < 0.6 and abs(off.mean()) < 0.01
    found = places(read_row, read_col, valid, ROWS, COLS)
    r, c = np.indices((ROWS, COLS)) + 0.5
    v, u = SCALE * r + OFF, (OFF + SCALE * c) / (1 - 2e-4 * SCALE * c)
    inner = np.s_[3:-3, 3:-3]
    off = np.hypot(*(np.stack(found.chart(r, c)) - np.stack([u, v])))[inner]
    assert np.sqrt((off**2).mean()) < 0.1  # camera pixels
    back = np.stack(found.lamp_of(u, v)) - np.stack([r, c])
    assert np.abs(back[(slice(None), *inner)]).max() < 0.1
    assert len(patterns(332, 1024)) == 30


def test_maps_follow_perspective_and_distortion():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 1000, (2, 4000))

    def lens(x: Array, y: Array) -> tuple[Array, Array]:
        a, b = (x - 500) / 500, (y - 480) / 500
        w, bent = 1 + 0.05 * a - 0.03 * b, 1 - 0.1 * (a * a + b * b) + 0.02 * (a * a + b * b) ** 2
        return 900 + 800 * a * bent / w, 500 + 700 * b * bent / w

    chart = Chart.fit((x, y), lens(x, y))
    at = rng.uniform(50, 950, (2, 500))
    assert np.abs(np.stack(chart(*at)) - np.stack(lens(*at))).max() < 0.01
    step = 1e-3
    by_x = (np.stack(lens(at[0] + step, at[1])) - np.stack(lens(at[0] - step, at[1]))) / (2 * step)
    np.testing.assert_allclose(chart.jacobian(*at)[:, 0], by_x, atol=1e-3)


def test_strays_do_not_bend_a_map():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 100, (2, 2000))
    u, v = 2 * x + 5, 2 * y - 3
    u[::50] += rng.uniform(-30, 30, len(u[::50]))
    chart = Chart.fit((x, y), (u, v))
    assert np.abs(chart(x, y)[0] - (2 * x + 5)).max() < 0.01
