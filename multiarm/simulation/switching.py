"""Going on with another method where a scene turns out to be stiff.

Damping, stiff springs or stiff gains make motions that die out at once but keep the steps of an
explicit method short.  The loop tells when that is so
(:func:`multiarm.integration.time_loop.note_stiffness`); then the linearly implicit method takes
over, on trial: a step of it costs many evaluations, and it stays only if it gets further with each
of them.
"""

from __future__ import annotations

from multiarm.integration.tableaus import EXPLICIT
from multiarm.integration.time_loop import STIFF_AFTER
from multiarm.simulation.setup import Run, make_stepping

FOR_STIFF_SCENES = "rodas5p"
# The method has shown how long its steps are after so many of them.
TRIAL_STEPS = 16
# Evaluations of an explicit step beside its stages: projection (two) and end.
_BESIDE_STAGES = 2


class Switch:
    """Which method a run goes on with."""

    def __init__(self) -> None:
        self._explicit: str | None = None
        self._pace = 0.0
        self._until = self._spent = 0
        self._since = 0.0

    def take_over(self, run: Run) -> None:
        """Go on with the method for stiff scenes, on trial."""
        method, clock = run.stepping.method, run.clock
        self._explicit = run.stepping.tableau.name
        self._pace = clock.h_before / (method.stages + _BESIDE_STAGES)
        self._change(run, FOR_STIFF_SCENES)
        self._tell(run, "the scene is stiff")

    def judge(self, run: Run) -> bool:
        """Whether the trial has just failed, so that the run goes on with the explicit method."""
        if self._explicit is None or run.clock.steps < self._until:
            return False
        explicit, kept = self._explicit, self._keeps(run)
        self._explicit = None
        if kept:
            return False
        self._change(run, explicit)
        self._tell(run, f"steps of {FOR_STIFF_SCENES} are too costly here")
        return True

    def _keeps(self, run: Run) -> bool:
        """Whether the method on trial gets further with an evaluation."""
        got_on = run.clock.t - self._since
        return got_on > self._pace * (_spent(run) - self._spent)

    def _change(self, run: Run, name: str) -> None:
        """Give a run another method; what it has come to stays."""
        old, run.stepping = run.stepping.step, make_stepping(run.data, name, run.tolerance)
        new = run.stepping.step
        new.z[:], new.base[:], new.slope[:] = old.z, old.base, old.slope
        run.settings = run.settings._replace(switch=False)
        self._until, self._spent = run.clock.steps + TRIAL_STEPS, _spent(run)
        self._since = run.clock.t

    def _tell(self, run: Run, why: str) -> None:
        name, t = run.stepping.tableau.name, run.clock.t
        text = f"{why}: the run goes on with {name}"
        run.log.add([{"time": t, "kind": "method", "text": text}])


def _spent(run: Run) -> int:
    """Evaluations without those of the samples, which cost the same with any method."""
    clock, projected = run.clock, run.settings.closed >= 0.0
    return clock.evaluations - clock.sample * (3 if projected else 1)


def stiffness_remark(run: Run) -> str:
    """What the user should know of a scene that is stiff: what was done, or should be; or empty."""
    clock = run.clock
    if run.stepping.tableau.name == FOR_STIFF_SCENES and run.may_switch:
        return (
            f"; the scene is stiff: {FOR_STIFF_SCENES} took over at t = {clock.stiff_since:.3g} s"
        )
    named = run.stepping.tableau.kind == EXPLICIT and not run.may_switch
    if not named or clock.stiff_steps < STIFF_AFTER:
        return ""
    since = f"stiff from t = {clock.stiff_since:.3g} s"
    return f"; the scene is {since}: `integrator: {FOR_STIFF_SCENES}` takes longer steps there"
