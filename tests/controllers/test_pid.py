"""The PID bank against python-control, and what its limits promise."""

from dataclasses import fields, replace

import control
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from torch import Tensor
from torch.testing import assert_close

from luxloop.controllers.pid import PidGains, PidParams, PidState, pid_gains, pid_reset, pid_step
from tests.refusal import refusal

gain = st.integers(0, 2000).map(lambda n: n / 1000)
filter_time = st.sampled_from([0.0, 0.05, 0.4])
time_step = st.sampled_from([1.0, 0.1, 1 / 30])


def bank(device: torch.device | str = "cpu", **loop: object) -> PidGains:
    return pid_gains([PidParams(**loop)], torch.float64, device)


def at_rest(gains: PidGains) -> PidState:
    """The zero initial state of a transfer function, where a reset would suppress the first derivative."""
    state = pid_reset(gains, torch.zeros_like(gains.kp))
    return replace(state, initialised=torch.ones_like(state.initialised))


def run(gains: PidGains, errors: Tensor, dt: float, state: PidState | None = None) -> Tensor:
    state = at_rest(gains) if state is None else state
    outputs = []
    for error in errors:
        state = pid_step(state, error, dt, gains)
        outputs.append(state.output)
    return torch.stack(outputs)


def transfer_function(kp: float, ki: float, kd: float, T: float, dt: float, form: str) -> control.TransferFunction:
    integrator = control.TransferFunction([dt, 0], [1, -1], dt)
    derivative = control.TransferFunction([1, -1], [T + dt, -T], dt)
    law = kp + ki * integrator + kd * derivative
    return law * integrator if form == "incremental" else law


@settings(max_examples=15)
@given(gain, gain, gain, filter_time, time_step, st.sampled_from(["position", "incremental"]))
def test_agrees_with_python_control(kp, ki, kd, T, dt, form):
    errors = np.random.default_rng(0).normal(size=40)
    gains = bank(kp=kp, ki=ki, kd=kd, derivative_time=T, form=form)
    ours = run(gains, torch.tensor(errors)[:, None], dt)[:, 0]
    expected = control.forced_response(transfer_function(kp, ki, kd, T, dt, form), inputs=errors).outputs
    # 300 random banks agree to 2e-13 of the largest output; the rest is room for other builds of LAPACK.
    np.testing.assert_allclose(ours, expected, atol=1e-10 * max(1, np.abs(expected).max()))


@pytest.mark.parametrize(("gains", "radius"), [((0.75, 0.5, 0.26), 0.65), ((0.5, 0.1, 0.1), 0.75)])
def test_thesis_gains_are_stable_in_incremental_form_at_unit_step(gains, radius):
    kp, ki, kd = gains
    loop = bank(kp=kp, ki=ki, kd=kd, form="incremental")

    def step(x: Tensor) -> Tensor:
        integral, previous_error, c = x[:, None]
        state = PidState(integral, torch.zeros_like(c), previous_error, c, torch.ones_like(c, dtype=torch.bool))
        state = pid_step(state, -c, 1.0, loop)  # the plant shows c, its target is 0
        return torch.cat([state.integral, state.previous_error, state.output])

    A = torch.autograd.functional.jacobian(step, torch.zeros(3, dtype=torch.float64))
    assert torch.linalg.eigvals(A).abs().max().item() == pytest.approx(radius, abs=0.005)  # quoted with two digits


@pytest.mark.parametrize("form", ["position", "incremental"])
@pytest.mark.parametrize(("tracking_time", "share"), [(0.4, 0.25), (1e-3, 1.0)], ids=["slow", "faster than a step"])
def test_each_step_takes_its_share_of_the_pid_sum_beyond_a_limit(form, tracking_time, share):
    gains = bank(kp=1.0, upper=0.0, tracking_time=tracking_time, form=form)
    state = at_rest(gains)
    for step in range(1, 6):
        state = pid_step(state, torch.full((1,), 3.0, dtype=torch.float64), 0.1, gains)
        assert (state.integral + 3.0).item() == pytest.approx(3.0 * (1 - share) ** step)  # on the limit, not beyond it, at a share of 1


@settings(max_examples=20)
@given(
    st.sampled_from(["position", "incremental"]),
    st.lists(st.floats(-50, 50), min_size=1, max_size=30),
    st.floats(-2, -0.1),
    st.floats(0.1, 3),
    st.floats(0.1, 5),
)
def test_limits_hold_for_any_error(form, errors, lower, upper, rate):
    gains = bank(kp=2.0, ki=1.0, kd=0.5, lower=lower, upper=upper, rate_limit=rate, tracking_time=0.5, form=form)
    outputs = run(gains, torch.tensor(errors, dtype=torch.float64)[:, None], 0.1)[:, 0]
    assert outputs.min() >= lower
    assert outputs.max() <= upper
    steps = outputs.diff(prepend=torch.zeros(1, dtype=torch.float64)).abs()
    assert steps.max() <= 0.1 * rate + 1e-12  # rounding of the difference


def test_reset_is_bumpless(device):
    start = torch.tensor([0.7], dtype=torch.float64, device=device)
    error = torch.tensor([5.0], dtype=torch.float64, device=device)
    loop = {"kp": 0.4, "ki": 0.2, "kd": 9.0}

    gains = bank(device, **loop)
    first = pid_step(pid_reset(gains, start), error, 0.1, gains)
    second = pid_step(first, error, 0.1, gains)
    assert_close(first.output, start)
    assert_close(second.output - start, torch.full_like(start, 0.2 * 5.0 * 0.1))  # the integral alone moves it
    changed = pid_step(second, 0 * error, 0.1, replace(gains, ki=10 * gains.ki, kp=0 * gains.kp, kd=0 * gains.kd))
    assert_close(changed.output, pid_step(second, 0 * error, 0.1, replace(gains, kp=0 * gains.kp, kd=0 * gains.kd)).output)

    gains = bank(device, **loop, form="incremental")
    first = pid_step(pid_reset(gains, start), error, 0.1, gains)
    assert_close(first.output, start + 0.1 * (0.4 + 0.2 * 0.1) * 5.0)  # no derivative kick


@pytest.mark.parametrize("form", ["position", "incremental"])
def test_batch_equals_singles(form, device):
    loops = [
        PidParams(kp=1.0, ki=0.3, kd=0.2, form=form),
        PidParams(kp=0.5, ki=0.1, derivative_time=0.2, lower=-0.4, upper=0.9, tracking_time=1.0, form=form),
        PidParams(kp=2.0, rate_limit=1.0, form=form),
    ]
    errors = torch.randn(12, 5, 3, generator=torch.Generator().manual_seed(1)).to(device)
    gains = pid_gains(loops, device=device)
    start = torch.zeros(5, 3, device=device)
    together = run(gains, errors, 0.1, pid_reset(gains, start))
    assert together.dtype == torch.float32
    for b in range(5):
        for n, loop in enumerate(loops):
            single = pid_gains([loop], device=device)
            alone = run(single, errors[:, b, n : n + 1], 0.1, pid_reset(single, start[b, n : n + 1]))
            assert_close(alone[:, 0], together[:, b, n])


@pytest.mark.parametrize("form", ["position", "incremental"])
@pytest.mark.parametrize("limits", [{}, {"lower": -1.0, "upper": 1.0, "tracking_time": 0.5}], ids=["unlimited", "limited"])
def test_gradients(form, limits):
    base = bank(**limits, form=form)
    errors = torch.tensor([0.3, -0.2, 1.5, 0.4], dtype=torch.float64)[:, None]

    def outputs(kp: Tensor, ki: Tensor, kd: Tensor, T: Tensor, errors: Tensor) -> Tensor:
        return run(replace(base, kp=kp, ki=ki, kd=kd, derivative_time=T), errors, 0.5)

    values = [torch.tensor([[v], [v / 2]], dtype=torch.float64, requires_grad=True) for v in (0.8, 0.4, 0.3, 0.2)]
    assert torch.autograd.gradcheck(outputs, [*values, errors.requires_grad_()])


def test_bad_input():
    with refusal("one form"):
        pid_gains([PidParams(), PidParams(form="incremental")])
    with pytest.raises(ValidationError, match=r"upper: 1 is not above lower = 2"):
        PidParams(lower=2.0, upper=1.0)
    with pytest.raises(ValidationError):
        PidParams(rate_limit=0.0)


def test_unlimited_defaults_keep_gradients_finite():
    gains = bank(kp=1.0, ki=0.1)
    leaves = [getattr(gains, f.name).requires_grad_() for f in fields(gains) if f.name != "form"]
    state = pid_step(pid_reset(gains, torch.zeros(1, dtype=torch.float64)), torch.ones(1, dtype=torch.float64), 0.1, gains)
    gradients = torch.autograd.grad(state.output.sum(), leaves, allow_unused=True)
    assert all(g is None or g.isfinite().all() for g in gradients)
