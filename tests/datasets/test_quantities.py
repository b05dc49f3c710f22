"""The quantity asked for selects the channel by name and unit; where two fit, none is taken."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import check_error

from cyclofeat._base.quantities import QUANTITIES
from cyclofeat.cli import main
from cyclofeat.datasets import describe, read_folder, read_recording, write_recording
from cyclofeat.datasets.readers import one_line
from cyclofeat.recordings import Recording

OUT, IN, CURRENT = QUANTITIES
GERMAN = "Abtriebsdrehmoment [Nm];Antriebsmoment [Nm];Motorstrom [A]"
ENGLISH = "Torque out (Nm),Torque in (Nm),Motor current (mA)"


def file_with(tmp_path, names):
    mark = ";" if ";" in names else ","
    rows = [mark.join(str(100 * row + column) for column in range(names.count(mark) + 1)) for row in (1, 2)]
    path = tmp_path / "rig.csv"
    path.write_text("\n".join([names, *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("names", "quantity", "column", "factor"),
    [
        (ENGLISH, None, 0, 1),
        (ENGLISH, OUT, 0, 1),
        (ENGLISH, IN, 1, 1),
        (ENGLISH, CURRENT, 2, 1e-3),
        (GERMAN, None, 0, 1),
        (GERMAN, IN, 1, 1),
        (GERMAN, CURRENT, 2, 1),
        ("Torque in (Nm),Torque out (Nm)", None, 1, 1),  # the order does not matter
        ("torque_in_ncm,torque", None, 1, 1),  # a torque that names no side is the output's
        ("torque_in_ncm,torque", IN, 0, 1e-2),
        ("torque,torque_in", IN, 1, 1),
        ("M1 [Nm],n [1/min],i1 [mA]", None, 0, 1),  # by the unit
        ("M1 [Nm],n [1/min],i1 [mA]", IN, 0, 1),
        ("M1 [Nm],n [1/min],i1 [mA]", CURRENT, 2, 1e-3),
        ("Torque in Nm,n", None, 0, 1),  # "in" is a word of the unit here
        ("Torque (lbf-ft),n", None, 0, 9.80665 * 0.45359237 * 0.3048),
        ("Torque [in.lb],n", None, 0, 9.80665 * 0.45359237 * 0.0254),
        ("n,i_q", CURRENT, 1, 1),
    ],
)
def test_names_and_units_select_the_channel(tmp_path, names, quantity, column, factor):
    recording = read_recording(file_with(tmp_path, names), sampling_rate=9, quantity=quantity)
    np.testing.assert_allclose(recording.torque, factor * (np.array([100, 200]) + column))
    assert recording.quantity == (quantity or OUT)
    assert recording.unit == ("A" if quantity == CURRENT else "Nm")


@pytest.mark.parametrize(
    ("names", "quantity", "words"),
    [
        ("torque in,motor torque,n", IN, "channel= must be given, ... fit: 'torque in', 'motor torque'"),
        ("current,motor current", CURRENT, "channel= must be given, ... fit: 'current', 'motor current'"),
        ("a,b", CURRENT, "channel= must be given, to say which column is the motor current: 'a', 'b'"),
        ("Torque in (Nm),n", None, "holds input torque by its name or unit, not output torque: give q"),
        ("motor torque", OUT, "'motor torque' holds input torque by its name or unit, not output"),
        ("x [A],n", None, "'x [A]' holds motor current"),
        ("torque out,n", IN, "'torque out' holds output torque by its name or unit, not input torque"),
        ("torque [A],n", None, "is in 'A', known are Nm ... or quantity='motor_current'"),
    ],
)
def test_what_does_not_hold_the_quantity_is_not_read_as_it(tmp_path, names, quantity, words):
    check_error(file_with(tmp_path, names), words, sampling_rate=9, quantity=quantity)


def test_a_channel_named_alone_must_not_hold_another_quantity_by_its_name(tmp_path):
    path = file_with(tmp_path, ENGLISH)
    check_error(path, "holds input torque ... if the name is wrong", sampling_rate=9, channel=1)
    # both stated: the names are wrong
    assert read_recording(path, sampling_rate=9, channel=1, quantity=OUT).torque[0] == 101


def test_a_torque_constant_turns_a_current_into_torque(tmp_path):
    recording = read_recording(file_with(tmp_path, GERMAN), sampling_rate=9, quantity=CURRENT, scale=0.05)
    np.testing.assert_allclose(recording.torque, [0.05 * 102, 0.05 * 202])
    assert (recording.quantity, recording.unit) == (CURRENT, "Nm")
    assert one_line(recording).startswith("rig.csv: motor current (Motorstrom [A]) 5.1 to 10.1 Nm")
    volts = file_with(tmp_path, "i_q [V],n")
    assert read_recording(volts, sampling_rate=9, quantity=CURRENT, scale=2).unit == "A"  # A per V


@pytest.mark.parametrize(("stated", "unit"), [("%", "%"), ("p.u.", "p.u."), ("pu", "p.u.")])
def test_a_current_may_be_a_share_of_the_rated_one(tmp_path, stated, unit):
    path = file_with(tmp_path, f"Motorstrom [{stated}];n")
    recording = read_recording(path, sampling_rate=9, quantity=CURRENT)
    np.testing.assert_array_equal(recording.torque, [100, 200])
    assert recording.unit == unit
    write_recording(tmp_path / "run.npz", recording)
    assert read_recording(tmp_path / "run.npz") == recording
    assert describe(recording)["warnings"][-1] == "no angle: positions of lobes will be relative"
    amperes = read_recording(path, sampling_rate=9, quantity=CURRENT, scale=0.1)
    assert (amperes.unit, amperes.torque[0]) == ("A", 10)
    path.write_text(f"Motorstrom;n\n{stated};\n1;2\n3;4\n", encoding="utf-8")  # a row of units
    assert read_recording(path, sampling_rate=9, quantity=CURRENT).unit == unit
    with pytest.raises(ValueError, match=r"known are Nm"):  # not of a torque
        read_recording(file_with(tmp_path, f"torque [{stated}],n"), sampling_rate=9)
    with pytest.raises(ValueError, match="channel= must be given"):  # nor does it tell a current
        read_recording(file_with(tmp_path, f"load [{stated}],n"), sampling_rate=9, quantity=CURRENT)


@pytest.mark.parametrize("ending", ["csv", "npz"])
@pytest.mark.parametrize("meta", [{}, {"unit": "Nm"}], ids=["stated unit", "scaled"])
@pytest.mark.parametrize("quantity", [IN, CURRENT])
def test_written_files_keep_the_quantity(tmp_path, ending, meta, quantity):
    recording = Recording([1.5, 2.5, 2.0], 9, quantity=quantity, meta=meta)
    path = tmp_path / f"run.{ending}"
    write_recording(path, recording)
    assert read_recording(path) == recording
    assert read_recording(path, quantity=quantity) == recording
    with pytest.raises(
        ValueError, match=rf"quantity = '{OUT}' contradicts the file, which says '{quantity}'"
    ):
        read_recording(path, quantity=OUT)


def test_an_array_of_another_program_is_in_the_unit_of_its_quantity(tmp_path):
    np.savez(tmp_path / "run.npz", motor_current=[0.5, 0.7], torque=[1.0, 2.0], sampling_rate=9.0)
    assert read_recording(tmp_path / "run.npz", quantity=CURRENT).torque.tolist() == [0.5, 0.7]
    np.savez(tmp_path / "run.npz", torque=[1.0, 2.0], sampling_rate=9.0, quantity="power")
    check_error(tmp_path / "run.npz", "run.npz: quantity must be one of 'output_torque', ... got 'power'")


def test_a_manifest_states_the_quantity_of_each_line(tmp_path):
    file_with(tmp_path, ENGLISH)
    manifest = tmp_path / "recordings.csv"
    manifest.write_text(f"file,sampling_rate,quantity\nrig.csv,9,{CURRENT}\nrig.csv,9,{IN}\nrig.csv,9,\n")
    assert [one.quantity for one in read_folder(tmp_path)] == [CURRENT, IN, OUT]
    assert {one.quantity for one in read_folder(tmp_path, quantity=IN)} == {IN}
    manifest.write_text("file,quantity\nrig.csv,torque\n")
    with pytest.raises(ValueError, match=r"line 2: quantity must be one of output_torque, .* got 'torque'"):
        read_folder(tmp_path)


def test_the_option_reads_another_quantity_and_errors_name_it(tmp_path, capsys):
    path = str(file_with(tmp_path, "Torque in (Nm),n"))
    assert main(["inspect", path, "--sampling-rate", "9"]) == 2
    assert "give --quantity 'input_torque', or --channel and --quantity" in capsys.readouterr().err
    assert main(["inspect", path, "--sampling-rate", "9", "--quantity", "input_torque"]) == 0
    assert "input torque (Torque in (Nm)) 100 to 200 Nm" in capsys.readouterr().out
