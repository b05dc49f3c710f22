"""Counts of samples that arrive in pieces."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cyclofeat._base import checks
from cyclofeat._base.quantities import number_of
from cyclofeat.counting.model._verdicts import window_faults
from cyclofeat.counting.model.lobe_count import AnsweredWindows, LobeCount, PreparedWindows, WindowCount
from cyclofeat.counting.model.lobe_model import LobeModel
from cyclofeat.recordings import Recording, WindowSet
from cyclofeat.recordings.windower import WindowStream, ends_by_angle
from cyclofeat.signal.windows import Float


class LobeStream:
    """Counter of worn lobes of samples that arrive in pieces of any size.

    With the angle of the input shaft, windows of 0.98 output turns are counted as soon as half an input turn
    behind them has arrived (more with a model of fewer than 128 samples per turn). They are those of
    :meth:`LobeModel.count` on the whole record: equal up to rounding while the speed is steady, else up to
    errors of interpolation of 0.1 %. Without an angle, the speed can be followed in a whole record only; the
    stream is then cut into blocks of ``block_turns`` output turns, and each is counted as a recording of its
    own. In either case the answers are the same, bit for bit, for any sizes of the pieces.

    The stream keeps the samples of about one window (one block without an angle) and some hundred bytes per
    window until :meth:`result`: call it from time to time. A depth of wear is stated of blocks only if they
    hold as many turns as it takes; shorter ones are also counted less accurately.

    Parameters
    ----------
    model : LobeModel
    sampling_rate : float
        In Hz.
    speed_rpm : float, optional
        Nominal speed of the input shaft in turns per minute; required without an angle. Of a model with a
        coarser one, that which the rate suits at this speed counts; without a speed, the finest.
    angle_is_absolute : bool, default=False
        See :class:`~cyclofeat.Recording`.
    block_turns : int, optional
        Output turns of a block, for a rig without a tachometer.

    Examples
    --------
    >>> stream = LobeStream(model, 25_600)  # doctest: +SKIP
    >>> for torque, angle in meter:  # doctest: +SKIP
    ...     for window in stream.push(torque, angle):
    ...         print(window.stop_s, window.defect_count, window.reason)
    >>> stream.result().defect_count  # doctest: +SKIP
    3
    """

    def __init__(
        self,
        model: LobeModel,
        sampling_rate: float,
        *,
        speed_rpm: float | None = None,
        angle_is_absolute: bool = False,
        block_turns: int | None = None,
    ) -> None:
        checks.check_type("model", model, LobeModel)
        self.model = model
        self.sampling_rate = checks.positive("sampling_rate", sampling_rate, "a number (Hz)")
        self.angle_is_absolute = checks.truth_value("angle_is_absolute", angle_is_absolute)
        self.block_turns = None if block_turns is None else checks.whole("block_turns", block_turns, 1)
        disc = {"n_lobes": model.n_lobes_, "quantity": model.card_["quantity"]}
        self._labels: dict[str, Any] = {"speed_rpm": speed_rpm} | disc
        nothing = Recording(np.zeros(8), self.sampling_rate, **self._labels)  # checks the speed
        if speed_rpm is not None:
            self.model = model.suited_to(nothing)
        self._block = 0
        if self.block_turns is not None:
            if self.angle_is_absolute:
                raise ValueError("angle_is_absolute must be False with block_turns: blocks have no angle")
            if speed_rpm is None:
                raise ValueError("speed_rpm must be given (nominal speed of the input) with block_turns")
            self._block = round(self.block_turns * model.n_lobes_ / (speed_rpm / 60) * self.sampling_rate)
        self._start_over()

    def _start_over(self) -> None:
        self._windows = WindowStream(
            self.model.windower_, self.sampling_rate, angle_is_absolute=self.angle_is_absolute, **self._labels
        )
        self._pieces: list[Float] = []
        self._n_samples = 0
        self._n_kept = 0  # of a block
        self._angles: tuple[float, float] | None = None  # first and last
        self._first_angle = np.nan
        self._answers: list[AnsweredWindows] = []
        self._counted: list[WindowCount] = []  # and not returned yet
        self._run: list[Float] = []  # of windows without a fault

    def push(self, samples: ArrayLike, angle: ArrayLike | None = None) -> list[WindowCount]:
        """Take the next samples and count the windows that they complete.

        Parameters
        ----------
        samples : array-like, shape (n,)
            In the unit of the model's recordings.
        angle : array-like, shape (n,), optional
            Angle of the input shaft in rad at these samples, strictly increasing over all pieces.

        Returns
        -------
        list of WindowCount
            In order, often none; after an error the next call returns those counted before it. ``reason`` is
            why a window is left out; a doubt about the whole record shows in :meth:`result` only. Times are
            in s from the first sample.

        Raises
        ------
        ValueError
            If samples are not finite, or the angle is missing, superfluous, of another length, does not
            increase or leaps an output turn (the piece is then not taken); if a window or block is constant
            or its rate too low (it is left out).
        """
        torque = checks.number_series("samples", samples, least=0)
        if self.block_turns is not None:
            if angle is not None:
                raise ValueError("angle has no effect with block_turns: leave one of them out")
            self._n_samples += torque.size
            self._count_blocks(torque)
            return self._take_counted()
        if angle is None:
            raise ValueError(
                "angle must be given (input shaft, rad); for a rig without a tachometer open the stream with "
                "block_turns and speed_rpm"
            )
        angles = checks.number_series("angle", angle, least=0)
        if angles.size != torque.size:
            raise ValueError(f"angle must have the length of samples, {torque.size}, got {angles.size}")
        if not torque.size:
            return self._take_counted()
        before = [] if self._angles is None else [self._angles[1]]
        steps = np.diff(np.concatenate([before, angles]))
        if not np.all(steps > 0):
            raise ValueError(
                "angle must increase strictly, in rad, also from piece to piece (an angle that starts again "
                "at each turn: numpy.unwrap)"
            )
        if steps.max(initial=0.0) > 2 * np.pi * self.model.n_lobes_:
            raise ValueError(
                f"angle must be in rad and advance by less than an output turn ({self.model.n_lobes_} of the "
                f"input) from one sample to the next, got {steps.max():.4g} rad: where that many samples are "
                "lost, call result() or open a new stream"
            )
        self._angles = (float(angles[0]) if self._angles is None else self._angles[0], float(angles[-1]))
        self._n_samples += torque.size
        for window in self._windows.push(torque, angles):
            self._count_window(*window)
        return self._take_counted()

    def result(self) -> LobeCount:
        """Count all windows since the stream began, as one recording, and begin anew.

        Returns
        -------
        LobeCount
            The count of all blocks, without positions of lobes: they are not followed from block to block.

        Raises
        ------
        ValueError
            If no window is complete; the stream then goes on.
        """
        doubt, notes = "", []
        if self.block_turns is None:
            for window in self._windows.finish():
                self._count_window(*window)
        else:  # behind one that raised an error
            self._count_blocks(np.empty(0))
        if not self._answers:
            needed = number_of(self.block_turns or 1, "output turn")
            raise ValueError(
                f"the stream holds no complete window: {self._n_samples / self.sampling_rate:.4g} s have "
                f"arrived, the first takes {needed}"
            )
        if self._angles is not None:
            turns = (self._angles[1] - self._angles[0]) / (2 * np.pi)
            doubt = self.model._untrained_speed(turns / (self._n_samples - 1) * self.sampling_rate)
        else:
            assert self.block_turns is not None
            blocks = number_of(self.block_turns, "output turn")
            notes.append(f"no tachometer: counted in blocks of {blocks}, without positions of lobes")
        answered = AnsweredWindows.join_parts(self._answers)
        count = self.model._count_of(answered, doubt, notes, absolute=self.angle_is_absolute)
        self._start_over()
        return count

    def _take_counted(self) -> list[WindowCount]:
        counted, self._counted = self._counted, []
        return counted

    def _count_window(self, windows: WindowSet, recording: Recording, first_sample: int) -> None:
        """Count one window: alone, so that its answer does not depend on the pieces."""
        assert recording.angle is not None
        length = windows.X.shape[1], windows.sampling_rate
        stop_s = ends_by_angle(windows.start_angle, *length, recording.angle, self.sampling_rate)
        faults = window_faults(recording, windows, stop_s, self.model.n_lobes_)
        if not self._answers:
            self._first_angle = float(windows.start_angle[0])
        prepared = PreparedWindows(windows, stop_s, faults, "", (), self._first_angle, True)
        (answered,) = self.model._answer_windows([prepared])
        wear, of_run = self.model.wear_, None
        if wear is not None:
            self._run = [] if faults[0] else [*self._run, windows.X[0]]
            if len(self._run) >= wear.n_windows:  # the window completes a run
                of_run = wear.answers(np.array(self._run), [""] * len(self._run))
                self._run = []
        self._keep_answers(dataclasses.replace(answered, runs=of_run), first_sample)

    def _count_blocks(self, torque: Float) -> None:
        """Count the blocks that the samples complete."""
        first = self._n_samples - torque.size - self._n_kept
        self._pieces.append(torque)
        self._n_kept += torque.size
        if self._n_kept < self._block:
            return
        joined = np.concatenate(self._pieces)
        begin = 0
        try:
            while joined.size - begin >= self._block:
                block = joined[begin : begin + self._block]
                begin += self._block
                prepared = self.model._prepare_windows(Recording(block, self.sampling_rate, **self._labels))
                (answered,) = self.model._answer_windows([prepared])
                faults = tuple(fault or prepared.doubt for fault in answered.faults)
                answered = dataclasses.replace(answered, faults=faults, lobe_proba=None)
                self._keep_answers(answered, first + begin - self._block)
        finally:
            self._pieces = [joined[begin:].copy()]
            self._n_kept = self._pieces[0].size

    def _keep_answers(self, answered: AnsweredWindows, first_sample: int) -> None:
        start_s, stop_s = (
            ends + first_sample / self.sampling_rate for ends in (answered.start_s, answered.stop_s)
        )
        answered = dataclasses.replace(answered, start_s=start_s, stop_s=stop_s)
        self._answers.append(answered)
        classes: NDArray[np.int64] = self.model.counter_.classes_
        self._counted += answered.window_counts(classes, answered.window_reasons())
