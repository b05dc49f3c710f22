"""Counter and locator for whole recordings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import Pipeline

from cyclofeat._base import displays
from cyclofeat._base.arguments import ArgumentError
from cyclofeat._base.checks import whole
from cyclofeat._base.displays import html_card
from cyclofeat._base.files import MODEL_PACKAGES, package_versions
from cyclofeat._base.quantities import TORQUES, factor_to_output
from cyclofeat._base.words import number
from cyclofeat.counting.calibration.pooling import combine_proba
from cyclofeat.counting.calibration.training_domain import TrainingDomain, features_seen
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.lobe_locator import LobeLocator, passage_of_lobe_zero
from cyclofeat.counting.estimators.row_counter import RowCounter
from cyclofeat.counting.evaluation.assembly_folds import fewest_assemblies
from cyclofeat.counting.evaluation.evaluate import Protocol
from cyclofeat.counting.evaluation.evaluation import score_text
from cyclofeat.counting.model._predictions import RecordingPredictions
from cyclofeat.counting.model._speed import other_speed
from cyclofeat.counting.model._training import (
    SPEED_MARGIN,
    fitted_counter,
    samples_per_turn_of,
    some_of_each_count,
    windows_to_learn,
)
from cyclofeat.counting.model._verdicts import disagreement, most_frequent, outvoted, window_faults
from cyclofeat.counting.model._window_answers import OUTSIDE, AnsweredWindows, PreparedWindows
from cyclofeat.counting.model.lobe_count import LobeCount
from cyclofeat.counting.model.radial_wear import RadialWear, stated_depths
from cyclofeat.counting.model.turning import Turning, turning_of
from cyclofeat.features import LobeMap
from cyclofeat.recordings import Recording, Windower, WindowSet
from cyclofeat.recordings.recording import common_n_lobes, common_quantity
from cyclofeat.recordings.windower import SAMPLES_PER_TURN, lobe_windower
from cyclofeat.signal.lobes import N_LINES, SPEED_TOLERANCE, LobeLines, lobe_frequency
from cyclofeat.signal.speed import FOLLOWED_TOLERANCE
from cyclofeat.signal.windows import Float

# Samples of windows that are counted together.
_BATCH_SAMPLES = 2**20
# Assemblies whose names a card lists: of more, which are simulated, none.
_MOST_NAMED = 1000
# Factor by which a mean torque may lie outside the loads of training without a note.
_FAR = 3.0
# Share of the torques of each count that rows learn a second time, as if they had no tachometer.
_BY_LINES_TOO = 1 / 3
# Number of places between two lobes at which a recording without an absolute angle may begin.
_BEGINNINGS = 4


@dataclass(eq=False)
class LobeModel(RecordingPredictions):
    """Counter and locator of worn lobes of recordings.

    Build it with :meth:`train`, for recordings at the speeds of the training with enough samples per turn, or
    of a counter that is fitted already with :meth:`of_counter`, for one sampling rate and speed.

    A model is a fitted classifier of recordings for scikit-learn too (``predict``, ``predict_proba``,
    ``score``, last step of a ``Pipeline``), and frozen like ``sklearn.frozen.FrozenEstimator``: ``fit``
    changes nothing and ``clone`` returns the model itself. :class:`RecordingCounter` is the estimator that
    learns in ``fit``; :class:`LobeStream` counts samples as they arrive.

    Attributes
    ----------
    counter : estimator
        Fitted classifier of windows, classes are defect counts. That of :meth:`train` has the steps
        ``"lobe_map"`` and ``"trees"``, the latter in a :class:`GroupCalibratedCounter`, or is a
        :class:`LobeCounter` or :class:`RowCounter`.
    locator : LobeLocator, LobeCounter, RowCounter or None
        Fitted; the counter itself where that is a :class:`LobeCounter` or :class:`RowCounter`. None where the
        training recordings did not state angle and worn lobes.
    n_lobes : int
    card : dict
        Training data and versions.
    domain : TrainingDomain or None
        Fitted to the features that the counter sees; None where there was one assembly only.
    sampling_rate, input_speed_hz : float or None
        Hz, and nominal turns per second, of the windows in time that the counter takes. None where it takes
        windows over the angle of the shaft, of any rate and speed.
    samples_per_turn : int
        Of windows over the angle: a recording must hold as many samples per input turn, and may hold more.
    wear : RadialWear or None
        Count and depth from several windows in a row, where the model was trained with the depth of radial
        wear; else None.
    coarser : LobeModel or None
        Model for recordings with fewer samples per input turn, which hold fewer lobe lines; see
        :meth:`with_coarser`.
    """

    counter: BaseEstimator
    locator: LobeLocator | LobeCounter | RowCounter | None
    n_lobes: int
    card: dict[str, Any] = field(repr=False)
    domain: TrainingDomain | None = None
    sampling_rate: float | None = None
    input_speed_hz: float | None = None
    wear: RadialWear | None = None
    samples_per_turn: int = SAMPLES_PER_TURN
    coarser: LobeModel | None = field(default=None, repr=False)

    @classmethod
    def train(
        cls,
        recordings: Sequence[Recording],
        *,
        random_state: int = 0,
        n_splits: int = 5,
        n_trees: int = 300,
        description: str = "",
        wear_um: tuple[float, float] | None = None,
        counter: str = "trees",
        samples_per_turn: int = SAMPLES_PER_TURN,
        epochs: int | None = None,
    ) -> LobeModel:
        """Train on labelled recordings, of any speeds, loads and sampling rates.

        Windows of one output turn are cut over the angle of the input shaft: a tachometer's, or the one that
        the lines of the torque give around the stated speed. They have ``samples_per_turn``, or as many as
        the recording with the fewest would hold at 5 % more speed. Of motor currents with a tachometer the
        counter also learns windows over the angle that their lines tell: counted without a tachometer, their
        lines are less sharp, as the speed of a controlled motor changes within a turn. ``"rows"`` learns
        such windows of a third of the torques too, but not with ``wear_um``.

        Where all recordings state which lobes are worn and some hold sets that are no row of neighbours, the
        counter is a :class:`LobeCounter`, which counts lobe by lobe; else trees on the lobe map.

        Parameters
        ----------
        recordings : sequence of Recording
            With ``defect_count``; where all of them also state ``worn_lobes`` and an absolute angle, the
            model learns to locate lobes too. Probabilities are calibrated on held-out assemblies; recordings
            are one assembly each if they do not all state theirs.
        random_state : int
            Seed of the trees.
        n_splits : int
            Folds of the cross-validation with whole assemblies held out, whose result goes on the card; 0
            for none. A :class:`RowCounter` has folds of its own, whose result is taken. Where a class has
            fewer assemblies than that there is none either, and the card says so.
        n_trees : int
            Trees of the counter.
        description : str
            Where the recordings come from, for the card.
        wear_um : (low, high), optional
            Range of radial wear in um whose depth is learned, that of ``meta["wear_um"]`` of all recordings
            with worn lobes. Counts are then made from as many windows in a row as the shortest recording
            holds, at most five, because early wear hardly shows in one. Default: no depth.
        counter : {"trees", "rows"}
            ``"rows"``: a :class:`RowCounter`, for neighbouring lobes that all recordings state. It counts
            more accurately, learns more slowly, and its file is small. It needs JAX and Optax for training.
            With ``wear_um`` it is more accurate than trees from some 500 assemblies of each count on; then
            single windows, where they have to do, are counted by what the first of each recording tells.
        samples_per_turn : int
            Samples per input turn of the windows: 128 hold 44 lobe lines. Of ``"rows"``, 256 hold 88, which
            tell counts better apart at low speeds; recordings to be counted must hold as many.
        epochs : int, optional
            Times that ``"rows"`` sees each window; with ``wear_um``, each run of windows. Default: 40, and
            more where they are few (``n_epochs`` of :class:`RowCounter`).

        Returns
        -------
        LobeModel

        Raises
        ------
        ImportError
            For ``"rows"`` if JAX or Optax is not installed.
        TypeError, ValueError
            Where recordings lack a defect count, hold one class only, differ in quantity or number of lobes,
            are shorter than an output turn, state neither angle nor speed, or hold too few samples per turn
            for lobe lines up to half the number of lobes; with ``wear_um`` also where a
            recording with worn lobes states no depth within the range.
        """
        if counter not in ("trees", "rows"):
            raise ValueError(f"counter must be 'trees' or 'rows', got {counter!r}")
        rows = counter == "rows"
        if whole("samples_per_turn", samples_per_turn, 1) > SAMPLES_PER_TURN and not rows:
            raise ValueError(
                f"samples_per_turn must be at most {SAMPLES_PER_TURN} for counter={counter!r}, which uses "
                f"{N_LINES} lobe lines, got {samples_per_turn}"
            )
        if epochs is not None:
            whole("epochs", epochs, 1)
            if not rows:
                raise ValueError(
                    f"epochs must be None unless counter='rows', got {epochs} with counter={counter!r}"
                )
        n_lobes, quantity = common_n_lobes(recordings), common_quantity(recordings)
        if any(recording.defect_count is None for recording in recordings):
            raise ValueError("recordings must all state their defect_count to train on, some do not")
        stated = None if wear_um is None else stated_depths(recordings, wear_um)
        # Faint lines are often right, but those of a sound disc are noise: the stated speed is safer.
        turnings = [turning_of(recording, n_lobes, by_faint_lines=False) for recording in recordings]
        per_turn = samples_per_turn_of(recordings, turnings, n_lobes, samples_per_turn)
        again: Sequence[int] = ()
        if quantity == "motor_current":
            again = range(len(recordings))
        elif rows and stated is None:
            again = some_of_each_count(recordings, _BY_LINES_TOO, random_state)
        windows = seen = windows_to_learn(recordings, turnings, again, n_lobes, per_turn)
        if again and stated is not None:  # depths are learned from the windows of the tachometer alone
            seen = windows_to_learn(recordings, turnings, (), n_lobes, per_turn)
        if rows and stated is not None:
            # Runs make the count. The windows of a recording are alike: the network learns the first.
            windows = windows.part(np.flatnonzero(np.diff(windows.recording, prepend=-1)))
        assert windows.y is not None
        if np.unique(windows.y).size < 2:
            raise ValueError(f"recordings must hold at least two defect counts, got {windows.y[0]} only")
        made_for = {
            "input_speed_hz": 1.0, "speed_tolerance": 0.0, "n_lobes": n_lobes, "n_trees": n_trees,
            "random_state": random_state,
        }  # fmt: skip
        protocol = Protocol(n_splits=n_splits, random_state=random_state) if n_splits else None
        fitted, locator, scores, features = fitted_counter(
            windows, made_for, protocol, rows=rows, epochs=epochs if stated is None else None
        )
        member = windows.recording if windows.groups is None else windows.groups
        domain = None
        if np.unique(member).size > 1:
            domain = TrainingDomain(random_state=random_state).fit(features, windows.y, groups=member)
        names = [] if windows.groups is None else np.unique(windows.groups).tolist()
        card = {
            "description": description,
            "quantity": quantity,
            "speeds_rpm": _range([60 * one.speed_hz for one in turnings]),
            "loads_nm": _range([one.load_nm for one in recordings if one.load_nm is not None]),
            "n_recordings": len(recordings),
            "n_windows": len(windows),
            "sources": sorted({str(r.source) for r in recordings}),
            "assemblies": names if 0 < len(names) <= _MOST_NAMED else None,
            "classes": np.unique(windows.y).tolist(),
            "calibrated": fewest_assemblies(member, windows.y) > 1,
            "cross_validation": scores,
            "versions": package_versions(*MODEL_PACKAGES),
        }
        wear = None
        if stated is not None:
            of_runs = clone(fitted).set_params(n_epochs=epochs) if rows else None
            wear = RadialWear.train(
                seen, stated, n_lobes=n_lobes, n_trees=n_trees, random_state=random_state, rows=of_runs
            )
            card["wear"] = wear.summary()
        return cls(fitted, locator, n_lobes, card, domain, wear=wear, samples_per_turn=per_turn)

    @classmethod
    def of_counter(
        cls,
        counter: BaseEstimator,
        *,
        sampling_rate: float,
        input_speed_hz: float = 500 / 60,
        n_lobes: int = 15,
        description: str = "",
    ) -> LobeModel:
        """Make a model for whole recordings of a counter that is fitted already; it locates no lobes.

        Parameters
        ----------
        counter : classifier
            Fitted to windows of one output turn, with ``predict_proba``; classes are defect counts.
        sampling_rate, input_speed_hz, n_lobes
            Attributes of the model.
        description : str
            For the card.

        Returns
        -------
        LobeModel

        Raises
        ------
        ValueError
            Where the counter was fitted to windows of another length.
        """
        samples = round(sampling_rate * n_lobes / input_speed_hz)
        fitted = int(counter.n_features_in_)
        if fitted != samples:
            raise ValueError(
                f"counter must be fitted to windows of one output turn, {samples} samples at "
                f"{sampling_rate:g} Hz and {60 * input_speed_hz:g} RPM, got one fitted to {fitted} samples"
            )
        parts = (counter, getattr(counter, "counter_", None))
        card = {
            "description": description,
            "classes": np.asarray(counter.classes_).tolist(),
            "calibrated": any(getattr(part, "calibrated_", False) for part in parts),
            "cross_validation": None,
            "versions": package_versions(*MODEL_PACKAGES),
        }
        return cls(counter, None, n_lobes, card, None, sampling_rate, input_speed_hz)

    def with_coarser(self, coarser: LobeModel) -> LobeModel:
        """Return the model with another one for recordings with fewer samples per input turn.

        Parameters
        ----------
        coarser : LobeModel
            Of the same quantity, disc and counts, with fewer ``samples_per_turn``. It may have a coarser one
            itself.

        Raises
        ------
        ValueError
            If it differs in one of these, has no fewer samples per turn, or a model is for one speed only.
        """
        for name, mine, other in (
            ("quantity", self.card.get("quantity"), coarser.card.get("quantity")),
            ("n_lobes", self.n_lobes, coarser.n_lobes),
            ("counts", self.classes_.tolist(), coarser.classes_.tolist()),
        ):
            if mine != other:
                raise ValueError(f"coarser must be a model of the same {name}, {mine}, got one of {other}")
        if self.input_speed_hz is not None or coarser.input_speed_hz is not None:
            raise ValueError("coarser and the model must be of LobeModel.train, got one for a single speed")
        if coarser.samples_per_turn >= self.samples_per_turn:
            raise ValueError(
                f"coarser must have fewer than {self.samples_per_turn} samples per turn, got "
                f"{coarser.samples_per_turn}"
            )
        return replace(self, coarser=coarser)

    def suited_to(self, recording: Recording) -> LobeModel:
        """Return the model, or the first of the coarser ones, whose samples per turn a recording holds.

        The last one where it holds too few for all.
        """
        if self.coarser is None:
            return self
        speed_hz = recording.mean_input_speed(self.n_lobes)
        if speed_hz is None and recording.input_speed_hz is not None:
            # It may turn faster, by what is followed at most.
            speed_hz = recording.input_speed_hz * (1 + FOLLOWED_TOLERANCE)
        elif speed_hz is None:
            speed_hz = turning_of(recording, self.n_lobes).speed_hz
        model = self
        while model.coarser is not None and recording.sampling_rate < model.samples_per_turn * speed_hz:
            model = model.coarser
        return model

    @property
    def classes_(self) -> NDArray[Any]:  # type: ignore[override]
        """Counts that the model knows, shape (n_classes,)."""
        return np.asarray(self.counter.classes_)

    def fit(self, recordings: object, y: object = None) -> Self:
        """Return the model unchanged, since it is trained; see :class:`RecordingCounter`."""
        return self

    def __sklearn_clone__(self) -> Self:
        return self

    def __sklearn_is_fitted__(self) -> bool:
        return True

    def _repr_mimebundle_(self, **_: object) -> dict[str, str]:
        return {"text/plain": repr(self), "text/html": self._repr_html_()}

    def _repr_html_(self) -> str:
        stated, scores = self.card, self.card.get("cross_validation")
        rows = {
            "for recordings": self.made_for(),
            "disc": f"{self.n_lobes} lobes",
            "counts": ", ".join(map(str, stated.get("classes", ()))),
            "trained on": stated.get("description"),
            "windows": stated.get("n_windows"),
            "cross-validation": score_text(scores) if scores else "none: accuracy unknown",
            "probabilities": "calibrated" if stated.get("calibrated") else "not calibrated",
            "locates lobes": "no" if self.locator is None else "yes",
            "refuses": "no" if self.domain is None else "what is unlike the training",
            "depth of wear": None if self.wear is None else self.wear.made_for(),
        }
        drawn = displays.draw_confusion(np.array(scores["confusion"]), scores["classes"]) if scores else ""
        return html_card("Counter of worn lobes", rows, pictures=[drawn], code="model.count(recording)")

    def made_for(self) -> str:
        """Return in words which recordings the model counts."""
        quantity = str(self.card.get("quantity", "output_torque")).replace("_", " ")
        if self.input_speed_hz is not None:
            return f"of {quantity} at {self.sampling_rate:g} Hz and {60 * self.input_speed_hz:g} RPM"
        parts = [f"of {quantity} at {_range_text(self.card['speeds_rpm'])} RPM"]
        if self.card["loads_nm"]:
            parts.append(f"{_range_text(self.card['loads_nm'])} Nm")
        made = " and ".join(parts)
        least = self
        while least.coarser is not None:
            least = least.coarser
        if least.samples_per_turn != SAMPLES_PER_TURN:
            made += f", with at least {least.samples_per_turn} samples per input turn"
        return made

    def check(self, recording: Recording) -> None:
        """Raise ``ValueError`` if the recording's quantity, lobes, sampling rate or speed do not suit."""
        quantity = self.card.get("quantity", "output_torque")
        if recording.quantity != quantity:
            raise ArgumentError(
                "{argument} of the recording is {got}, but the model was trained on {trained}: train a model "
                "on recordings of that quantity",
                argument="quantity", got=recording.quantity, trained=quantity,
            )  # fmt: skip
        # 15 is the default of recordings that do not state their lobes.
        if recording.n_lobes not in (15, self.n_lobes):
            raise ValueError(
                f"n_lobes of the recording is {recording.n_lobes}, but the model was trained for discs of "
                f"{self.n_lobes}: train a model for them"
            )
        if self.input_speed_hz is None or self.sampling_rate is None:
            return
        if abs(recording.sampling_rate / self.sampling_rate - 1) > 1e-6:
            raise ValueError(
                f"sampling_rate of the recording is {recording.sampling_rate:g} Hz, but the model was "
                f"trained at {self.sampling_rate:g} Hz: resample the recording or train a model at its rate"
            )
        stated = {"speed_rpm of the recording is": recording.input_speed_hz}
        # Speed by the tachometer too, in the middle half, away from a run-up.
        middle = recording.part(0.25 * recording.duration, 0.75 * recording.duration)
        stated["the angle of the recording turns at"] = middle.mean_input_speed(self.n_lobes)
        for source, speed in stated.items():
            if speed is not None and abs(speed / self.input_speed_hz - 1) > SPEED_TOLERANCE:
                raise ValueError(
                    f"{source} {60 * speed:.5g} RPM, but the model was trained at "
                    f"{60 * self.input_speed_hz:.5g} RPM: train a model at that speed"
                )

    def windows(self, recording: Recording) -> WindowSet:
        """Cut a recording into the windows that the counter takes.

        Raises
        ------
        ValueError
            Where the recording does not suit the model or is shorter than one output turn.
        """
        self.check(recording)
        return self.suited_to(recording)._cut(recording)[0]

    def speed_of(self, recording: Recording) -> float:
        """Return the input speed in turns per second at which a recording is drawn.

        The stated one; where that is not close to the shaft's or not known, the shaft's, but at least so
        fast that the recording holds one output turn. For a counter of windows in time, the model's.
        """
        stated = recording.input_speed_hz
        if self.input_speed_hz is not None:
            return stated or self.input_speed_hz
        measured = turning_of(recording, self.n_lobes).speed_hz
        if stated is not None and abs(measured / stated - 1) <= SPEED_TOLERANCE:
            return stated
        return max(measured, self.n_lobes / recording.duration)

    def _cut(self, recording: Recording) -> tuple[WindowSet, Turning | None]:
        """Return windows, and how the shaft turned where they are cut over its angle."""
        if self.input_speed_hz is not None:
            windower = Windower(input_speed_hz=self.input_speed_hz, reduction=self.n_lobes)
            return windower.windows([recording]), None
        turning = turning_of(recording, self.n_lobes)
        windows = lobe_windower(self.n_lobes, self.samples_per_turn).windows([recording], [turning.angle])
        return windows, turning

    def count(self, recording: Recording) -> LobeCount:
        """Count and locate the worn lobes of one recording.

        The probabilities of windows of one output turn are multiplied, and tempered by their dependence; a
        counter that has learned none is taken to be no surer of many windows than of one. Windows whose
        signal has a fault, or that lie outside the training domain, are left out. The recording is refused if
        more than half of its windows are, where some are and not more than half of all have its count, where
        the windows disagree, where its speed lies outside those of training, or where, without a tachometer,
        its lines are those of another speed or show none; it still has a count.

        Raises
        ------
        TypeError
            Where something else than a recording is given.
        ValueError
            Where the recording does not suit the model or is shorter than one output turn.
        """
        if not isinstance(recording, Recording):
            raise TypeError(f"recording must be a Recording object, got {type(recording).__name__}")
        model = self.suited_to(recording)
        return model._counts([model._prepared(recording)])[0]

    def count_all(self, recordings: Iterable[Recording]) -> list[LobeCount]:
        """Count and locate the worn lobes of many recordings.

        Windows of several recordings are counted together, which is faster than :meth:`count` one by one and
        gives the same answers up to rounding. Of a generator, windows of one batch are in memory at a time,
        8 MB of them and what is computed from these.

        Parameters
        ----------
        recordings : iterable of Recording

        Returns
        -------
        list of LobeCount
            In order; see also :func:`counts_frame`.

        Raises
        ------
        TypeError
            Where something else than recordings is given.
        ValueError
            Where a recording does not suit the model or is shorter than one output turn; the message states
            its place.
        """
        if isinstance(recordings, Recording):
            raise TypeError("recordings must be a list of Recording objects, got one: use count")
        answers: list[LobeCount] = []
        batch: list[PreparedWindows] = []
        model, n_samples = self, 0
        for place, recording in enumerate(recordings):
            if not isinstance(recording, Recording):
                raise TypeError(
                    f"recordings must be Recording objects, got {type(recording).__name__} at {place}"
                )
            try:
                suited = self.suited_to(recording)
                prepared = suited._prepared(recording)
            except ValueError as error:
                raise ValueError(f"recording {place}: {error}") from error
            if suited is not model or n_samples >= _BATCH_SAMPLES:
                answers += model._counts(batch)
                model, batch, n_samples = suited, [], 0
            batch.append(prepared)
            n_samples += prepared.windows.X.size
        return answers + model._counts(batch)

    def _prepared(self, recording: Recording) -> PreparedWindows:
        """Cut a recording that suits the model into windows, and look for faults."""
        self.check(recording)
        windows, turning = self._cut(recording)
        notes = []
        if turning is not None and turning.note:
            notes.append(turning.note)
        if turning is None and recording.input_speed_hz is None:
            assert self.input_speed_hz is not None
            notes.append(
                f"no speed stated: taken as {60 * self.input_speed_hz:g} RPM, as the model was trained"
            )
        if far := self._far_from_loads(recording):
            notes.append(far)
        stops = _stops(windows, recording, turning)
        faults = window_faults(recording, windows, stops, self.n_lobes)
        doubt = self._doubted(recording, windows, turning)
        return PreparedWindows(windows, stops, faults, doubt, tuple(notes), float(windows.start_angle[0]))

    def _far_from_loads(self, recording: Recording) -> str:
        """Return a note on a mean torque that no load of the training had; a count does not depend on it."""
        loads = self.card.get("loads_nm")
        if not loads or recording.quantity not in TORQUES:
            return ""
        low, high = sorted(abs(load) / factor_to_output(recording.quantity, self.n_lobes) for load in loads)
        low = low if min(loads) * max(loads) > 0 else 0.0
        mean = abs(float(recording.torque.mean()))
        # A mean below the ripple may have been removed.
        if high == 0 or mean < recording.torque.std() or low / _FAR <= mean <= high * _FAR:
            return ""
        return (
            f"the mean torque, {mean:.4g} Nm, is far from the {low:.3g} to {high:.3g} Nm of the training: "
            "are unit and scale right?"
        )

    def _counts(self, batch: Sequence[PreparedWindows]) -> list[LobeCount]:
        """Count recordings, their windows together."""
        return [
            self._count_of(answered, one.doubt, one.notes, absolute=_is_absolute(one))
            for one, answered in zip(batch, self._answered(batch), strict=True)
        ]

    def _count_of(
        self, answered: AnsweredWindows, doubt: str, first_notes: Sequence[str], *, absolute: bool
    ) -> LobeCount:
        """Combine the answers for all windows of a recording."""
        notes = list(first_notes)
        classes = self.classes_
        distance, n_outside = float(np.median(answered.distance)), int(np.sum(answered.distance > 1))
        reason, reasons = answered.refusals(doubt)
        reason = reason or disagreement(answered.proba, answered.faults)
        used = np.array([not one for one in reasons])
        used |= not used.any()
        learned = getattr(self._deciding(), "dependence_", None)
        member = np.zeros(used.sum(), dtype=int)
        probability = combine_proba(answered.proba[used], member, 1.0 if learned is None else learned)[0]
        if self.wear is None and not reason:
            reason = outvoted(answered.proba, reasons, int(probability.argmax()))
        runs = None if self.wear is None or reason else answered.wear
        if self.wear is not None and runs is not None:
            probability = self.wear.probability(runs)
        elif self.wear is not None and not reason:
            turns = number(self.wear.n_windows, "output turn")
            notes.append(
                f"no depth of wear, and a less accurate count: {turns} in a row of one recording are needed"
            )
        count = int(classes[probability.argmax()])
        n_windows = len(answered)
        if any(answered.faults) and not reason:
            left_out = f"{sum(map(bool, answered.faults))} of {number(n_windows, 'window')} left out"
            notes.append(f"{left_out}: {most_frequent(answered.faults)}")
        if n_outside:
            notes.append(
                f"{n_outside} of {n_windows} window{'s' if n_windows > 1 else ''} {OUTSIDE}: "
                f"{distance:.2f} times the largest distance inside{' (median)' if n_windows > 1 else ''}"
            )
        lobes: list[int] = []
        share: Float = np.zeros(0)
        if answered.lobe_proba is not None:
            # Where between two lobes the recording begins may be unknown: take the place with the most
            # decided answer.
            places = answered.lobe_proba[:, used].mean(axis=1)
            share = places[np.abs(places - 0.5).sum(axis=1).argmax()]
            lobes = sorted(np.argsort(-share, kind="stable")[:count].tolist())
            if not absolute and lobes:
                notes.append(
                    "positions are relative: without an absolute angle they count from the lobe under load "
                    "at the first sample counted"
                )
        if probability.max() < 0.5 and not reason:
            alone = f"no count is more probable than all others together: {count} has {probability.max():.2f}"
            # Where a depth is stated, wear is seen although its lobes are hard to count.
            if runs is None:
                reason = alone
            else:
                notes.append(alone)
        if count == 0 and self.wear is None and not reason:
            notes.append("fainter wear than in training may not show")
        if not self.card.get("calibrated", False):
            notes.append("probabilities are not calibrated on assemblies that training did not see")
        return LobeCount(
            defect_count=count,
            probability={int(c): float(p) for c, p in zip(classes, probability, strict=True)},
            lobes=tuple(lobes),
            lobe_probability=tuple(share.tolist()),
            absolute=answered.lobe_proba is not None and absolute,
            n_windows=int(used.sum()),
            warnings=tuple(notes),
            refused=bool(reason),
            reason=reason,
            distance=distance,
            windows=answered.counts(classes, reasons),
            wear_um=None if self.wear is None or runs is None else self.wear.depth_of(runs, count),
        )

    def _answered(self, batch: Sequence[PreparedWindows]) -> list[AnsweredWindows]:
        """Answer for the windows of several recordings together."""
        if not batch:
            return []
        X = np.concatenate([one.windows.X for one in batch])
        proba, features, lines = self._window_answers(X)
        distances = self._distances(X, features)
        ends = np.cumsum([len(one.windows) for one in batch])
        rows = [slice(end - len(one.windows), end) for end, one in zip(ends.tolist(), batch, strict=True)]
        located: Sequence[Float | None] = [None] * len(batch)
        if self.locator is not None:
            if lines is None:
                lines = self.locator.lobe_map_.lines(X)
            located = self._lobe_proba(batch, lines, rows, proba)
        return [
            AnsweredWindows(
                one.windows.start_s,
                one.stop_s,
                proba[row],
                distances[row],
                one.faults,
                lobes,
                None if self.wear is None else self.wear.answers(one.windows.X, one.faults),
            )
            for one, row, lobes in zip(batch, rows, located, strict=True)
        ]

    def _deciding(self) -> Any:
        """Return the part of the counter that decides: behind the lobe map, which other parts reuse."""
        if isinstance(self.counter, Pipeline) and isinstance(self.counter[0], LobeMap):
            rest = self.counter[1:]
            return rest[0] if len(rest) == 1 else rest
        return self.counter

    def _window_answers(self, X: Float) -> tuple[Float, Float | None, LobeLines | None]:
        """Return the probabilities of each count for each window.

        Also return the features in which the domain measures distances, and the lobe lines: they take most of
        the time, so that locator and domain reuse those of the counter. None where the counter has none.
        """
        lines, features = None, None
        deciding, seen = self._deciding(), X
        if deciding is not self.counter:
            lines = self.counter[0].lines(X)
            features = seen = self.counter[0].from_lines(lines)
            if isinstance(deciding, Pipeline) and self.domain is not None:
                features = np.asarray(deciding[:-1].transform(features))
        elif isinstance(self.counter, (LobeCounter, RowCounter)):
            lines = self.counter.lobe_map_.lines(X)
            features = self.counter.lobe_map_.from_lines(lines)
            return self.counter.proba_of_lines(lines), features, lines
        elif self.domain is not None:
            features = features_seen(self.counter, X)
        return np.asarray(deciding.predict_proba(seen)), features, lines

    def _doubted(self, recording: Recording, windows: WindowSet, turning: Turning | None) -> str:
        """Return why the speed of the recording is doubted, or not one of training; else empty."""
        if turning is None:
            return "" if recording.angle is not None else self._another_speed(windows.X)
        return turning.doubt or self._untrained_speed(turning.speed_hz)

    def _untrained_speed(self, speed_hz: float) -> str:
        """Return why a mean speed is not one of training; else empty."""
        low, high = self.card["speeds_rpm"]
        rpm = 60 * speed_hz
        if low * (1 - SPEED_MARGIN) <= rpm <= high * (1 + SPEED_MARGIN):
            return ""
        return f"it turns at {rpm:.5g} RPM, but the model was trained at {_range_text((low, high))} RPM"

    def _another_speed(self, X: Float) -> str:
        """Return why the torque cannot come from the model's speed; empty if there is no evidence."""
        assert self.input_speed_hz is not None
        assert self.sampling_rate is not None
        first = self.counter[0] if isinstance(self.counter, Pipeline) else None
        searched = first.speed_tolerance if isinstance(first, LobeMap) else 0.0
        tolerance = max(SPEED_TOLERANCE, searched)
        speed = other_speed(X, self.sampling_rate, self.input_speed_hz, tolerance, self.n_lobes)
        if speed is None:
            return ""
        return (
            f"its torque repeats as lobes at another speed would, such as {60 * speed:.0f} RPM, rather than "
            f"at the model's {60 * self.input_speed_hz:.0f} RPM"
        )

    def _distances(self, X: Float, features: Float | None) -> Float:
        """Return the distance of each window to the domain's nearest class; NaN without a domain."""
        if self.domain is None or features is None:
            return np.full(len(X), np.nan)
        return self.domain.distance(features)

    def _lobe_proba(
        self, batch: Sequence[PreparedWindows], lines: LobeLines, rows: Sequence[slice], of_counts: Float
    ) -> list[Float]:
        """Return the probability of each lobe, numbered as on the disc or from the first sample.

        Each of shape (n_places, n_windows, n_lobes), see :class:`AnsweredWindows`.
        """
        assert self.locator is not None
        begins: list[Float] = []
        for one, row in zip(batch, rows, strict=True):
            if _is_absolute(one):
                begins.append(passage_of_lobe_zero(one.windows.start_angle, self.n_lobes)[np.newaxis])
                continue
            # Windows are aligned by the turns between them.
            turned = _turned(one, lines.input_speed_hz[row])
            places = np.arange(_BEGINNINGS)[:, np.newaxis] / (_BEGINNINGS * self.n_lobes)
            begins.append(places - lobe_frequency(1.0, self.n_lobes) * turned)
        repeated = [
            np.tile(np.arange(row.start, row.stop), len(b)) for b, row in zip(begins, rows, strict=True)
        ]
        passages = np.concatenate([places.ravel() for places in begins])
        row_of = np.concatenate(repeated)
        known = {"proba": of_counts[row_of]} if isinstance(self.locator, RowCounter) else {}
        proba = self.locator._from_lines(lines.part(row_of), passages, **known)
        parts = np.split(proba, np.cumsum([places.size for places in begins])[:-1])
        return [part.reshape(*places.shape, -1) for part, places in zip(parts, begins, strict=True)]


def _range(values: Sequence[float]) -> list[float] | None:
    """Return the least and the largest value; None of none."""
    return [float(min(values)), float(max(values))] if values else None


def _range_text(ends: Sequence[float]) -> str:
    low, high = (f"{end:.4g}" for end in ends)
    return low if low == high else f"{low} to {high}"


def _stops(windows: WindowSet, recording: Recording, turning: Turning | None) -> Float:
    """Return the ends of the windows in s."""
    n_samples = windows.X.shape[1]
    if turning is None:
        return np.asarray(windows.start_s + n_samples / windows.sampling_rate)
    turned = 2 * np.pi * n_samples / windows.sampling_rate
    return turning.times(windows.start_angle + turned, recording.sampling_rate)


def _is_absolute(prepared: PreparedWindows) -> bool:
    """Return True if lobes of the recording are numbered as on the disc."""
    return bool(prepared.windows.absolute.all())


def _turned(prepared: PreparedWindows, speed_hz: Float) -> Float:
    """Return the input turns from the start of a recording's first window to the start of each."""
    windows = prepared.windows
    if np.isfinite(windows.start_angle).all():
        return np.asarray((windows.start_angle - prepared.first_angle) / (2 * np.pi))
    return np.asarray(cumulative_trapezoid(speed_hz, windows.start_s, initial=0))
