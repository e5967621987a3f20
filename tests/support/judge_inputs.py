"""Judge the answers of the program to malformed inputs.

python tests/support/judge_inputs.py --cases 5000   many more, each in a process of its own
"""

from __future__ import annotations

import argparse
import io
import json
import os
import re
import resource
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import h5py
import numpy as np
from malformed_inputs import Case, all_cases, stored_run, stored_sweep, system
from typer.testing import CliRunner

from multiarm.cli import app
from multiarm.errors import MultiarmError

LONGEST = 4000  # characters of a message
PATIENCE = 60  # [s] for one answer; the kernels may have to be compiled first
MEMORY = 6 << 30  # [bytes] of address space for a case that could use all
RAW = re.compile(r"Traceback|[a-z]Warning\b|0x[0-9a-f]{8}|For further information|pydantic|yaml\.")


class TooSlowError(BaseException):
    """The answer takes too long."""


@contextmanager
def patience(seconds: float) -> Iterator[None]:
    def end(*_: Any) -> None:
        raise TooSlowError

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def descriptors() -> Iterator[Any]:
    """What libraries write to stdout and stderr below Python, in a file."""
    sys.stdout.flush(), sys.stderr.flush()
    with TemporaryFile() as file:
        kept = os.dup(1), os.dup(2)
        os.dup2(file.fileno(), 1), os.dup2(file.fileno(), 2)
        try:
            yield file
        finally:
            for number, old in zip((1, 2), kept, strict=True):
                os.dup2(old, number)
                os.close(old)


def shortcomings(case: Case, folder: Path) -> list[str]:
    """What is wrong with the answer to an input."""
    before = os.getcwd()
    os.chdir(folder)
    try:
        with warnings.catch_warnings(), patience(PATIENCE), descriptors() as below:
            warnings.simplefilter("error")
            warnings.simplefilter("always", UserWarning)  # multiarm's own
            given = case.make(folder)
            if not callable(given):  # the command line translates them
                warnings.simplefilter("default", RuntimeWarning)
            if callable(given):
                found = _of_call(case, given)
            else:
                found = _of_command(case, [str(word) for word in given])
            below.seek(0)
            printed = below.read(2000).decode("utf-8", "replace")
        if printed:
            found.append(f"a library prints: {printed[:200]!r}")
    except TooSlowError:
        return ["slow"]
    finally:
        os.chdir(before)
    return [*found, *_files(folder)]


def _of_call(case: Case, call: Any) -> list[str]:
    try:
        with redirect_stdout(io.StringIO()) as out, redirect_stderr(out):
            result = call()
    except MultiarmError as error:
        return _message(str(error))
    except Exception as error:
        return [f"traceback: {_last(error)}"]
    if getattr(result, "status", "") == "failed":
        return _message(result.message)
    return ["accepted"] if case.refused else []


def _of_command(case: Case, words: list[str]) -> list[str]:
    result = CliRunner().invoke(app, words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        if isinstance(result.exception, TooSlowError):
            return ["slow"]
        return [f"traceback: {_last(result.exception)}"]
    if result.exit_code == 0:
        found = ["accepted"] if case.refused else []
        told = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
        return [*found, *(text for line in told for text in _message(line))]
    if result.exit_code not in (1, 2):
        return [f"exit code {result.exit_code}"]
    text = result.stderr
    found = _message(text)
    errors = len(re.findall(r"^error: |^╭─ Error", text, re.MULTILINE))
    if errors != 1:
        found.append(f"{errors} errors: {text[:300]!r}")
    return found


def _message(text: str) -> list[str]:
    found = []
    if len(text) > LONGEST:
        found.append(f"long: {len(text)} characters, {text[:60]!r}")
    if not text.strip():
        found.append("empty message")
    if RAW.search(text):
        found.append(f"raw words: {RAW.search(text)[0]!r} in {text[:200]!r}")
    return found


def _last(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "/multiarm/" in frame.filename] or frames
    where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
    return f"{type(error).__name__} at {where}: {str(error)[:150]!r}"


def _files(folder: Path) -> list[str]:
    """Numbers that are not finite in files that were written."""
    found = []
    for path in folder.glob("out.json"):
        if path.is_file() and re.search(r"\b(NaN|Infinity)\b", path.read_text(encoding="utf-8")):
            found.append(f"a number in {path.name} is not finite")
    for path in [*folder.glob("out.h5"), *folder.glob("run.h5")]:
        if path.is_file() and path.stat().st_size and h5py.is_hdf5(path):
            with h5py.File(path) as file:
                file.visititems(lambda name, own: found.extend(_finite(name, own)))
    return found


def _finite(name: str, dataset: Any) -> list[str]:
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind != "f" or "columns" in name:
        return []  # in a sweep, NaN stands for no number
    return [] if np.isfinite(dataset[()]).all() else [f"{name} is not finite"]


def in_own_process(case: Case) -> list[str]:
    """The shortcomings, judged by a child process with little memory."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        found = ["no answer"]
        try:
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            with TemporaryDirectory() as folder:
                found = shortcomings(case, Path(folder))
        except BaseException as error:
            found = [f"traceback: {_last(error)}"]
        finally:
            os.write(writer, json.dumps(found).encode()[:60_000])
            os._exit(0)
    os.close(writer)
    deadline = time.monotonic() + 2 * PATIENCE
    answer = b""
    os.set_blocking(reader, False)
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done or time.monotonic() > deadline:
            break
        time.sleep(0.005)
    if not done:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(reader)
        return ["hangs"]
    with os.fdopen(reader, "rb") as pipe:
        answer = pipe.read() or b""
    if os.WIFSIGNALED(status) or not answer:
        return [f"killed by signal {os.WTERMSIG(status)}"]
    return json.loads(answer)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=0, help="about so many")
    parser.add_argument("--only", default="", help="of these kinds or names")
    parser.add_argument("--out", help="JSON of all failures")
    parser.add_argument("--heavy", action="store_true", help="only those that could exhaust memory")
    options = parser.parse_args()
    few, more = len(all_cases(0)), len(all_cases(1))
    scale = max(1, -(-(options.cases - few) // (more - few)))
    cases = [case for case in all_cases(scale) if options.only in str(case)]
    if options.heavy:
        cases = [case for case in cases if case.heavy][::3]
    stored_run(), stored_sweep(), system()  # once for all children
    failed: dict[str, list[str]] = {}
    slowest: list[tuple[float, str]] = []
    for case in cases:
        start = time.monotonic()
        found = in_own_process(case)
        slowest.append((time.monotonic() - start, str(case)))
        if found:
            failed[str(case)] = found
            print(f"{case}: {'; '.join(found)[:400]}", flush=True)
    kinds = Counter(case.kind for case in cases)
    wrong = Counter(name.partition(":")[0] for name in failed)
    for kind, count in kinds.items():
        print(f"{kind:28} {count:6} inputs {wrong[kind]:6} failed")
    print(f"{'all':28} {len(cases):6} inputs {len(failed):6} failed")
    sorts = Counter(
        re.split(r"[:\d]", text)[0].strip() for found in failed.values() for text in found
    )
    print(dict(sorts))
    print("slowest:", [f"{name} {seconds:.1f} s" for seconds, name in sorted(slowest)[-5:]])
    if options.out:
        Path(options.out).write_text(json.dumps(failed, indent=1), encoding="utf-8")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
