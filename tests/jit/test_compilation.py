"""Claims about the time that threads wait for the compiler, and the clock that stands still."""

from __future__ import annotations

import time
from threading import Event, Thread

import numpy as np
import pytest
from numba import njit
from repository import SCENES

import multiarm as ma
from multiarm.jit import compilation
from multiarm.jit.compilation import (
    compile_time,
    compiling,
    is_compiling,
    process_running_time,
    running_time,
)
from multiarm.jit.kernels import kernel

CLOCK = 0.02  # [s] two readings of different clocks differ by less


def fresh_function():
    """A function that nobody has compiled yet; compiling it takes some tenths of a second."""

    @njit
    def polynomial(x):
        total = 0.0
        for i in range(x.size):
            total += x[i] ** 3 + np.sin(x[i])
        return total + np.sort(x)[0]

    return polynomial


def test_what_numba_compiles_is_compile_time_and_what_runs_is_not():
    function, x = fresh_function(), np.linspace(0.0, 1.0, 5)
    before, began, clock = compile_time(), time.perf_counter(), running_time()
    function(x)
    took, compiled = time.perf_counter() - began, compile_time() - before
    assert 0.05 < compiled <= took
    assert running_time() - clock == pytest.approx(took - compiled, abs=CLOCK)
    function(x)
    assert compile_time() - before == compiled, "it is compiled once"


def test_a_kernel_that_another_process_compiles_is_waited_for():
    @kernel
    def half(x):
        return 0.5 * x

    half.expect_in_cache(lambda: time.sleep(0.2))
    before = compile_time()
    assert half(3.0) == 1.5
    assert compile_time() - before > 0.2


def test_time_counts_for_the_thread_that_waits_and_the_clock_of_the_process_stands_still():
    entered, leave = Event(), Event()

    def wait():
        with compiling(), compiling():
            entered.set()
            leave.wait()

    thread = Thread(target=wait)
    before, clock = compile_time(), running_time()
    thread.start()
    entered.wait()
    assert is_compiling()
    process_clock = process_running_time()
    time.sleep(0.1)
    assert process_running_time() - process_clock == pytest.approx(0.0, abs=1e-4)
    leave.set()
    thread.join()
    assert not is_compiling() and compile_time() == before
    assert running_time() - clock > 0.1
    assert compilation._PROCESS.seconds() > 0.1


def test_compilation_is_no_part_of_the_wall_time_of_a_run():
    """A control function is compiled in the middle of the run, as stiff scenes' methods are."""
    system = ma.compile_system(ma.load_scene(SCENES / "two_ur5_box.yaml"))
    function, arms = fresh_function(), system.model.layout.names
    ma.simulate(system, 0.02, control=lambda t, state: {})

    def control(t, state):
        zero = 0.0 * function(state.position) if t > 0.01 else 0.0
        return {name: np.full(6, zero) for name in arms}

    began = time.perf_counter()
    run = ma.simulate(system, 0.02, control=control, accuracy=1e-4)
    took = time.perf_counter() - began
    statistics, attempts = run.statistics, run.certificate["attempts"]
    assert statistics["compile_time_s"] > 0.05
    assert statistics["compile_time_s"] == sum(row["compile_time_s"] for row in attempts)
    walls = sum(row["wall_time_s"] for row in attempts)
    assert walls + statistics["compile_time_s"] <= took
    assert statistics["realtime_factor"] == pytest.approx(0.02 / statistics["wall_time_s"])
    assert run.summary()["compile_time_s"] == statistics["compile_time_s"]


def test_a_stepper_tells_compilation_apart_too():
    system = ma.compile_system(ma.load_scene(SCENES / "two_ur5_box.yaml"))
    function = fresh_function()

    def control(t, state):
        return {"left": np.full(6, 0.0 * function(state.position))}

    stepper = ma.Stepper(system.with_control(control), accuracy=1e-3, record=True)
    began = time.perf_counter()
    stepper.advance(0.01)
    took, counted = time.perf_counter() - began, stepper.trajectory().statistics
    assert counted["compile_time_s"] > 0.05  # the start evaluates the control
    assert counted["wall_time_s"] <= took
