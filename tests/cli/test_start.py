"""Start and end of the command as a process: what it loads, and how Ctrl-C and a closed output end it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

GOLDEN = Path(__file__).parents[1] / "golden"
ALLOWED = ("cyclofeat", "scikit-learn", "python", "numpy", "scipy")
UNUSED = {
    "numba", "pandas", "pyarrow", "skops", "matplotlib", "jinja2", "h5py", "nptdms", "scipy.io", "pytest",
    "dask", "cyclofeat.simulators", "cyclofeat.gap", "cyclofeat.report",
}  # fmt: skip
# Sends the signal at the import of a module, while its importers are half loaded.
INTERRUPTED = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores the keyboard
moment = sys.argv.pop(1)
class Moment:
    def find_spec(name, path=None, target=None):
        if name == moment:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Moment)
from cyclofeat.__main__ import main
sys.exit(main())
"""


@pytest.fixture
def counting(tmp_path):
    """Words of a command that counts a recording with a ``.skops`` model."""
    with np.load(GOLDEN / "recordings.npz") as stored:
        torque = stored["codes"][0] * 2e-3
    np.savez(tmp_path / "disc.npz", torque=torque, sampling_rate=2560.0, speed_rpm=500.0)
    allow = [word for name in ALLOWED for word in ("--allow", name)]
    return ["count", str(tmp_path / "disc.npz"), "--model", str(GOLDEN / "model.skops"), *allow]


# Prints the exit code, how many files of this package have functions that ran, and all imported modules.
WATCHED = """
import pathlib, sys
entered = set()
def watch(frame, event, argument):
    if event == "call" and frame.f_code.co_flags & 1:  # a function: no module and no body of a class
        entered.add(frame.f_code.co_filename)
from cyclofeat.cli import main
sys.setprofile(watch)
code = main(sys.argv[1:])
sys.setprofile(None)
rooms = {path for name in ("cyclofeat", "cyclofeat.simulators", "cyclofeat.datasets")
         if name in sys.modules for path in sys.modules[name].__path__}
own = [name for name in entered if any(pathlib.Path(name).is_relative_to(room) for room in rooms)]
print(code, len(own), *sys.modules)
"""
MOST_FILES, MOST_MODULES = 40, 90


@pytest.mark.slow
def test_a_count_enters_few_files_and_loads_nothing_that_it_does_not_need(counting):
    done = subprocess.run([sys.executable, "-c", WATCHED, *counting], capture_output=True, text=True)
    code, files, *modules = done.stdout.splitlines()[-1].split()
    assert (code, done.returncode) == ("0", 0), done.stderr
    assert not UNUSED & set(modules)
    own = [name for name in modules if name.split(".")[0] == "cyclofeat"]
    assert int(files) <= MOST_FILES, "a reader must follow a count through more files"
    assert len(own) <= MOST_MODULES, own


def test_an_error_loads_nothing_that_it_does_not_need(tmp_path):
    code = "import sys; from cyclofeat.cli import main; print(main(sys.argv[1:]), *sys.modules)"
    command = [sys.executable, "-c", code, "history", str(tmp_path / "absent.sqlite")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    status, *modules = done.stdout.split()
    assert status == "2"
    assert done.stderr.startswith("cyclofeat: error: no such history: ")
    assert not UNUSED & set(modules)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
@pytest.mark.parametrize(
    ("moment", "cut_off"),
    [
        *((moment, False) for moment in ("argparse", "cyclofeat.cli.count", "numpy.linalg", "scipy.special")),
        ("scipy.special", True),
    ],
)
def test_ctrl_c_ends_imports_with_one_line(moment, cut_off, counting):
    code = INTERRUPTED
    if cut_off:  # as pybind11 ends the import of a compiled module
        error = "raise ImportError('initialization failed') from KeyboardInterrupt()"
        code = code.replace("os.kill(os.getpid(), signal.SIGINT)", error)
    command = [sys.executable, "-c", code, moment, *counting]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "cyclofeat: interrupted\n")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_soon_after_the_start_ends_with_one_line(counting):
    code = INTERRUPTED.replace("sys.exit", "print('started', flush=True); sys.exit")
    command = [sys.executable, "-c", code, "", *counting]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout.readline() == "started\n"
        with pytest.raises(subprocess.TimeoutExpired):  # nobody counts as soon as that
            child.wait(0.3)
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=120)
    assert (child.returncode, out, err) == (130, "", "cyclofeat: interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="closes a pipe before it is written to")
@pytest.mark.parametrize("words", ["--help", "count --help", "plan --worn-count 3 --noise 0.5"])
def test_an_answer_into_a_closed_pipe_ends_quietly(words):
    reader, writer = os.pipe()
    os.close(reader)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    command = [sys.executable, "-m", "cyclofeat", *words.split()]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, env=environment)
    os.close(writer)
    # As of a program that the signal of a broken pipe has ended.
    assert (done.returncode, done.stderr) == (141, b"")
