"""Estimator that counts and locates the worn lobes of whole recordings."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.pipeline import Pipeline
from sklearn.utils import gen_batches
from sklearn.utils.validation import check_is_fitted

from cyclofeat._base.checks import whole
from cyclofeat._base.displays import Card, WithCard, draw_confusion
from cyclofeat._base.files import MODEL_PACKAGES, package_versions
from cyclofeat._base.quantities import TORQUES, factor_to_output, in_words, number_of
from cyclofeat.counting.calibration.pooling import pool_windows
from cyclofeat.counting.calibration.training_domain import (
    TrainingDomain,
    feature_words,
    features_seen,
    lowest_seen,
)
from cyclofeat.counting.estimators.lobe_counter import LobeCounter
from cyclofeat.counting.estimators.lobe_positions import passage_of_lobe_zero
from cyclofeat.counting.estimators.trees import PoorOnArbitraryData
from cyclofeat.counting.evaluation.assembly_folds import of_windows
from cyclofeat.counting.evaluation.evaluate import Protocol
from cyclofeat.counting.evaluation.evaluation import score_text
from cyclofeat.counting.model._training import (
    SPEED_MARGIN,
    angles_to_learn,
    common_samples_per_turn,
    draw_per_count,
    fit_counter,
    is_network,
    make_counter,
    windows_at,
)
from cyclofeat.counting.model._verdicts import (
    disagreement_reason,
    most_frequent,
    outvoted_reason,
    window_faults,
)
from cyclofeat.counting.model.lobe_count import DENIED, OUTSIDE, AnsweredWindows, LobeCount, PreparedWindows
from cyclofeat.counting.model.radial_wear import RadialWear, breaks_between, stated_depths
from cyclofeat.counting.model.turning import Turning, turning_of
from cyclofeat.features import LobeMap
from cyclofeat.features.base import reject_short_windows
from cyclofeat.recordings import Recording, WindowSet
from cyclofeat.recordings.recording import common_n_lobes, common_quantity
from cyclofeat.recordings.windower import SAMPLES_PER_TURN, Windower, ends_by_angle, lobe_windower
from cyclofeat.signal.lobes import N_LINES, LobeLines, lobe_frequency, tell_wear
from cyclofeat.signal.speed import FOLLOWED_TOLERANCE, SMALL, shaft_lines
from cyclofeat.signal.windows import Float

# Samples of windows that are counted together.
_BATCH_SAMPLES = 2**20
# Longest list of assembly names on a card; more are simulated.
_MOST_NAMED = 1000
# Factor by which a mean torque may lie outside the loads of training without a note.
_FAR = 3.0
# Fraction of the recordings per count that a network learns a second time, without their tachometer.
_REPEATED_SHARE = 1 / 3
# Number of places between two lobes at which a recording without an absolute angle may begin.
_START_PLACES = 4
# Of a window with mesh lines alone: probability of a sound disc; largest distance inside, with a tachometer.
_SURELY_SOUND, _QUIET = 0.99, 2.0


@dataclass(eq=False, repr=False)
class LobeModel(WithCard, PoorOnArbitraryData, ClassifierMixin, BaseEstimator):
    """Estimator that counts and locates the worn lobes of recordings, of any speeds, loads and rates.

    ``X`` is a list of :class:`~cyclofeat.Recording` everywhere. ``fit`` cuts labelled recordings into windows
    of one output turn over the angle of the input shaft: a tachometer's, or the one that the lines of the
    torque give around the stated speed. A counter of windows, its probabilities, the domain of the training
    data and, where known, the positions of worn lobes are learned from them. ``count_all`` answers with
    counts, positions, and reasons of refusals; ``predict`` and ``predict_proba`` are scikit-learn's view of
    the same answers. :class:`LobeStream` counts samples as they arrive.

    Parameters
    ----------
    windower : Windower, optional
        Cuts windows over the angle. A recording with fewer than its ``samples_per_turn`` lowers them for all.
        Default: 0.98 output turns of 128 samples per input turn, without the mean torque. 128 samples hold 44
        lobe lines. Of ``"rows"``, 256 hold 88, which tell counts better apart at low speeds; recordings to be
        counted must hold as many.
    counter : {"trees", "rows"} or classifier, default="trees"
        Counter of windows. ``"trees"``: a :class:`LobeCounter`. ``"rows"``: one of kind "network", for
        neighbouring lobes that all recordings state, whose training needs JAX and Optax. With ``wear_um`` it
        is more accurate than trees from some 500 assemblies of each count on; single windows are then counted
        by what the first of each recording tells. Of another classifier, such as a pipeline, steps with the
        parameters ``sampling_rate``, ``input_speed_hz``, ``n_lobes`` or ``speed_tolerance`` get those of the
        windows; wrap it in a :class:`GroupCalibratedCounter` for calibrated probabilities. It locates no
        lobes.
    n_trees : int, default=300
        Trees of ``"trees"`` and of the depth of wear.
    epochs : int, optional
        Times that ``"rows"`` sees each window; with ``wear_um``, each run of windows. Default: 40, and more
        where they are few (``n_epochs`` of :class:`LobeCounter`).
    wear_um : (low, high), optional
        Range of radial wear in um whose depth is learned, that of ``meta["wear_um"]`` of all recordings with
        worn lobes. Counts are then made from as many windows in a row as the shortest recording holds, at
        most five, because early wear hardly shows in one. Default: no depth.
    n_splits : int, default=5
        Folds of the cross-validation with whole assemblies held out, whose result goes on the card; 0, or
        where a class has fewer assemblies, for none. ``"rows"`` has folds of its own.
    random_state : int, optional
        Seed of trees, networks and folds.
    description : str, default=""
        Where the recordings come from, for the card.

    Attributes
    ----------
    classes_ : ndarray, shape (n_classes,)
        Labels of the counts, in the order of the columns of :meth:`predict_proba`.
    counter_ : classifier
        Fitted counter of windows; its ``classes_`` are the numbers of worn lobes.
    domain_ : TrainingDomain or None
        Fitted to the features that the counter sees; None where there was one assembly only.
    alone_is_sound_, lines_are_worn_ : bool
        Of a :class:`LobeCounter`: whether lines of the mesh alone tell a sound disc, and clear lobe lines
        that it is none. False where training holds the contrary, of faint wear or of sound discs with flaws.
    wear_ : RadialWear or None
        Count and depth from several windows in a row, with ``wear_um``.
    card_ : dict
        Training data, cross-validated scores and versions.
    n_lobes_ : int
        Lobes of a disc.
    samples_per_turn_ : int
        Samples per input turn of the windows: recordings must hold as many, and may hold more.
    coarser_ : LobeModel or None
        Model for recordings with fewer samples per input turn, see :meth:`with_coarser`.

    Examples
    --------
    >>> from sklearn.model_selection import StratifiedGroupKFold, cross_val_predict
    >>> model = LobeModel(n_trees=100, random_state=0)
    >>> model.fit(recordings).predict(others)  # doctest: +SKIP
    >>> assemblies = [recording.assembly for recording in recordings]  # doctest: +SKIP
    >>> folds = StratifiedGroupKFold(5)
    >>> cross_val_predict(model, recordings, counts, groups=assemblies, cv=folds)  # doctest: +SKIP
    """

    windower: Windower | None = None
    counter: BaseEstimator | str = "trees"
    _: KW_ONLY
    n_trees: int = 300
    epochs: int | None = None
    wear_um: tuple[float, float] | None = None
    n_splits: int = 5
    random_state: int | None = None
    description: str = ""

    def fit(
        self, recordings: Sequence[Recording], y: ArrayLike | None = None, groups: ArrayLike | None = None
    ) -> Self:
        """Learn from labelled recordings.

        From motor currents with a tachometer the counter also learns windows over the angle that their lines
        tell, which are less sharp. ``"rows"`` learns such windows of a third of the torques too, but not with
        ``wear_um``.

        Parameters
        ----------
        recordings : sequence of Recording
            Where all of them state ``worn_lobes`` and an absolute angle, the model learns to locate lobes.
        y : array-like of int, shape (n_recordings,), optional
            True counts, or other numbers for the counts that the recordings state; default, the
            ``defect_count`` of the recordings.
        groups : array-like, shape (n_recordings,), optional
            Assembly of each recording; default, the ``assembly`` of the recordings. Probabilities are
            calibrated on held-out assemblies; if not all state theirs, each recording is an assembly.

        Returns
        -------
        self

        Raises
        ------
        ImportError, TypeError, ValueError
            If JAX or Optax is missing for ``"rows"``; where recordings lack a defect count, hold one class
            only, differ in quantity or number of lobes, are shorter than a window, state neither angle nor
            speed, or hold too few samples per turn for lobe lines up to half the number of lobes; where one
            with worn lobes states no depth within ``wear_um``, or ``y`` contradicts ``defect_count``.
        """
        kind = self.counter
        if isinstance(kind, str) and kind not in ("trees", "rows"):
            raise ValueError(f"counter must be 'trees', 'rows' or a classifier of windows, got {kind!r}")
        if kind == "trees" and (self._chosen_windower.samples_per_turn or 0) > SAMPLES_PER_TURN:
            raise ValueError(
                f"samples_per_turn must be at most {SAMPLES_PER_TURN} for counter='trees', which uses "
                f"{N_LINES} lobe lines, got {self._chosen_windower.samples_per_turn}"
            )
        if self.epochs is not None and whole("epochs", self.epochs, 1) and kind != "rows":
            raise ValueError(
                f"epochs must be None unless counter='rows', got {self.epochs} with counter={kind!r}"
            )
        known, label_of = _label_recordings(recordings, y, groups)
        n_lobes, quantity = common_n_lobes(known), common_quantity(known)
        depths = None if self.wear_um is None else stated_depths(known, self.wear_um)
        # Faint lines are often right, but those of a sound disc are noise: the stated speed is safer.
        turnings = [turning_of(recording, n_lobes, by_faint_lines=False) for recording in known]
        windows, windows_for_wear = self._training_windows(known, turnings, n_lobes, quantity)
        assert windows.y is not None
        if np.unique(windows.y).size < 2:
            raise ValueError(f"recordings must hold at least two defect counts, got {windows.y[0]} only")
        counter = make_counter(
            kind, windows, n_lobes, n_trees=self.n_trees, epochs=self.epochs, random_state=self.random_state
        )
        epochs = getattr(counter, "n_epochs", None)
        if is_network(counter) and depths is not None:
            counter.set_params(n_epochs=None)
        protocol = Protocol(n_splits=self.n_splits, random_state=self.random_state) if self.n_splits else None
        with reject_short_windows():
            self.counter_, scores, features = fit_counter(counter, windows, n_lobes, protocol)
        self.domain_: TrainingDomain | None = None
        if np.unique(windows.recording if windows.groups is None else windows.groups).size > 1:
            self.domain_ = self._fit_domain(windows, features)
        if isinstance(self.counter_, LobeCounter):
            alone, clear = tell_wear(features, n_lobes)
            # Faint wear may leave the lines of the mesh alone, and flaws of sound lobes have lines too.
            self.alone_is_sound_ = not np.any(alone[windows.y > 0])
            self.lines_are_worn_ = not np.any(clear[windows.y == 0])
        names = [] if windows.groups is None else np.unique(windows.groups).tolist()
        self.card_: dict[str, Any] = {
            "description": self.description,
            "quantity": quantity,
            "speeds_rpm": _value_range([60 * turning.speed_hz for turning in turnings]),
            "loads_nm": _value_range([r.load_nm for r in known if r.load_nm is not None]),
            "n_recordings": len(known),
            "n_windows": len(windows),
            "sources": sorted({str(recording.source) for recording in known}),
            "assemblies": names if 0 < len(names) <= _MOST_NAMED else None,
            "classes": np.unique(windows.y).tolist(),
            "calibrated": getattr(self._deciding_part, "calibrated_", False),
            "cross_validation": scores,
            "versions": package_versions(*MODEL_PACKAGES),
        }
        self.wear_: RadialWear | None = None
        if depths is not None:
            network = clone(counter).set_params(n_epochs=epochs) if is_network(counter) else None
            self.wear_ = RadialWear.train(
                windows_for_wear, depths, n_lobes=n_lobes, n_trees=self.n_trees, network=network,
                random_state=self.random_state,
            )  # fmt: skip
            self.card_["wear"] = self.wear_.summary()
        self.n_lobes_, self.samples_per_turn_ = n_lobes, round(windows.sampling_rate)
        self.coarser_: LobeModel | None = None
        self.classes_: NDArray[Any] = np.array([label_of[c] for c in self.counter_.classes_.tolist()])
        return self

    def learn_domain(self, recordings: Sequence[Recording]) -> LobeModel:
        """Return the model with a domain learned from other recordings; its counter stays as it is.

        Its coarser models learn theirs from the same recordings. A recording with an angle gives windows with
        it, and over the angle that its lines tell.

        Parameters
        ----------
        recordings : sequence of Recording
            Of the model's quantity and disc, of at least two assemblies, with their ``defect_count``; as many
            as there are features, and better ten times as many.

        Returns
        -------
        LobeModel
        """
        check_is_fitted(self)
        known, _ = _label_recordings(recordings, None, None)
        for recording in known:
            self._check_recording(recording)
        turnings = [turning_of(recording, self.n_lobes_, by_faint_lines=False) for recording in known]
        angles = angles_to_learn(known, turnings, range(len(known)), self.n_lobes_)
        return self._with_domain(known, angles)

    def _with_domain(self, recordings: Sequence[Recording], angles: Sequence[tuple[int, Float]]) -> LobeModel:
        """Return the model and its coarser ones with domains of the windows over these angles."""
        windows = windows_at(recordings, angles, self.windower_)
        parts = gen_batches(len(windows), max(1, _BATCH_SAMPLES // windows.X.shape[1]))
        features = [features_seen(self.counter_, windows.X[rows]) for rows in parts]
        model = copy.copy(self)
        model.domain_ = self._fit_domain(windows, np.concatenate(features))
        model.coarser_ = None if self.coarser_ is None else self.coarser_._with_domain(recordings, angles)
        model.card_ = self.card_ | {"domain": f"{len(recordings)} recordings, {len(windows)} windows"}
        return model

    def _fit_domain(self, windows: WindowSet, features: Float) -> TrainingDomain:
        domain = TrainingDomain(lowest_seen(self.counter_), random_state=self.random_state)
        assemblies = windows.recording if windows.groups is None else windows.groups
        domain.fit(features, windows.y, groups=assemblies)
        return domain

    @property
    def locator_(self) -> LobeCounter | None:
        """The counter where it locates lobes: training recordings all state worn lobes and absolute angle."""
        counter = self.counter_
        return counter if isinstance(counter, LobeCounter) and counter.locates else None

    def _training_windows(
        self, recordings: Sequence[Recording], turnings: Sequence[Turning], n_lobes: int, quantity: str
    ) -> tuple[WindowSet, WindowSet]:
        """Return the windows that the counter learns, and those from which the depth of wear is learned."""
        windower = self._chosen_windower
        if windower.samples_per_turn is None:
            raise ValueError(
                "windower must have samples_per_turn, because the model counts windows over the angle of the "
                f"shaft, got {windower}"
            )
        per_turn = common_samples_per_turn(recordings, turnings, n_lobes, windower.samples_per_turn)
        windower = replace(windower, reduction=n_lobes, samples_per_turn=per_turn)
        by_network = self.counter == "rows" or is_network(self.counter)
        once = list(enumerate(turning.angle for turning in turnings))
        angles = once
        if quantity == "motor_current":
            angles = angles_to_learn(recordings, turnings, range(len(recordings)), n_lobes)
        elif by_network and self.wear_um is None:
            repeated = draw_per_count(recordings, _REPEATED_SHARE, self.random_state)
            angles = angles_to_learn(recordings, turnings, repeated, n_lobes)
        windows = windows_for_wear = windows_at(recordings, angles, windower)
        if angles is not once and self.wear_um is not None:
            windows_for_wear = windows_at(recordings, once, windower)
        if by_network and self.wear_um is not None:
            # Runs make the count. The windows of a recording are alike: the network learns the first.
            windows = windows.part(np.flatnonzero(np.diff(windows.recording, prepend=-1)))
        return windows, windows_for_wear

    @property
    def _chosen_windower(self) -> Windower:
        return lobe_windower() if self.windower is None else self.windower

    @property
    def windower_(self) -> Windower:
        """Windower of the fitted model."""
        return replace(
            self._chosen_windower, reduction=self.n_lobes_, samples_per_turn=self.samples_per_turn_
        )

    def with_coarser(self, coarser: LobeModel) -> LobeModel:
        """Return the model with another one for recordings with fewer samples per input turn.

        Parameters
        ----------
        coarser : LobeModel
            Fitted, of the same quantity, disc and counts, with fewer ``samples_per_turn_``. It may have a
            coarser one itself.

        Returns
        -------
        LobeModel
        """
        check_is_fitted(self)
        check_is_fitted(coarser)
        for name, mine, other in (
            ("quantity", self.card_["quantity"], coarser.card_["quantity"]),
            ("n_lobes", self.n_lobes_, coarser.n_lobes_),
            ("counts", self.classes_.tolist(), coarser.classes_.tolist()),
        ):
            if mine != other:
                raise ValueError(f"coarser must be a model of the same {name}, {mine}, got one of {other}")
        if coarser.samples_per_turn_ >= self.samples_per_turn_:
            raise ValueError(
                f"coarser must have fewer than {self.samples_per_turn_} samples per turn, got "
                f"{coarser.samples_per_turn_}"
            )
        model = copy.copy(self)
        model.coarser_ = coarser
        return model

    def suited_to(self, recording: Recording) -> LobeModel:
        """Return the model, or the first of the coarser ones, whose samples per turn a recording holds.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        LobeModel
            The coarsest one where the recording holds too few samples for all.
        """
        if self.coarser_ is None:
            return self
        speed_hz = recording.mean_input_speed(self.n_lobes_)
        if speed_hz is None and recording.input_speed_hz is not None:
            # It may turn faster, by what is followed at most.
            speed_hz = recording.input_speed_hz * (1 + FOLLOWED_TOLERANCE)
        elif speed_hz is None:
            speed_hz = turning_of(recording, self.n_lobes_).speed_hz
        model = self
        while model.coarser_ is not None and recording.sampling_rate < model.samples_per_turn_ * speed_hz:
            model = model.coarser_
        return model

    def predict(self, recordings: Iterable[Recording]) -> NDArray[Any]:
        """Return the most probable number of worn lobes of each recording.

        Recordings that the model refuses have one too: :attr:`LobeCount.refused` of :meth:`count_all` says
        which, and why.

        Parameters
        ----------
        recordings : iterable of Recording

        Returns
        -------
        ndarray, shape (n_recordings,)
            Values of ``classes_``.
        """
        counts = [answer.defect_count for answer in self.count_all(recordings)]
        return np.asarray(self.classes_[np.searchsorted(self.counter_.classes_, counts)])

    def predict_proba(self, recordings: Iterable[Recording]) -> Float:
        """Return the probability of each count for each recording, refused or not.

        Parameters
        ----------
        recordings : iterable of Recording

        Returns
        -------
        ndarray, shape (n_recordings, n_classes)
            :attr:`LobeCount.probability`, columns in the order of ``classes_``.
        """
        answers = self.count_all(recordings)
        rows = [[*answer.probability.values()] for answer in answers]
        return np.array(rows, dtype=np.float64).reshape(-1, len(self.classes_))

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array = False
        return tags

    def _repr_mimebundle_(self, **_: object) -> dict[str, str]:
        return {"text/plain": repr(self), "text/html": self._repr_html_()}

    def _card(self) -> Card:
        if not hasattr(self, "card_"):
            return Card("Counter of worn lobes", {"trained on": "nothing yet"}, code="model.fit(recordings)")
        stated, scores = self.card_, self.card_.get("cross_validation")
        rows = {
            "for recordings": self.made_for(),
            "disc": f"{self.n_lobes_} lobes",
            "counts": ", ".join(map(str, stated.get("classes", ()))),
            "trained on": stated.get("description"),
            "windows": stated.get("n_windows"),
            "cross-validation": score_text(scores) if scores else "none: accuracy unknown",
            "probabilities": "calibrated" if stated.get("calibrated") else "not calibrated",
            "locates lobes": "no" if self.locator_ is None else "yes",
            "refuses": "no" if self.domain_ is None else "what is unlike the training",
            "depth of wear": None if self.wear_ is None else self.wear_.made_for(),
        }
        return Card(
            "Counter of worn lobes", rows,
            lambda: [draw_confusion(np.array(scores["confusion"]), scores["classes"])] if scores else [],
            code="model.count(recording)",
        )  # fmt: skip

    def made_for(self) -> str:
        """Return in words which recordings the model counts.

        Returns
        -------
        str
        """
        parts = [f"of {in_words(self.card_['quantity'])} at {_range_text(self.card_['speeds_rpm'])} RPM"]
        if self.card_["loads_nm"]:
            parts.append(f"{_range_text(self.card_['loads_nm'])} Nm")
        text = " and ".join(parts)
        least = self
        while least.coarser_ is not None:
            least = least.coarser_
        if least.samples_per_turn_ != SAMPLES_PER_TURN:
            text += f", with at least {least.samples_per_turn_} samples per input turn"
        return text

    def _check_recording(self, recording: Recording) -> None:
        """Raise ``ValueError`` if the recording's quantity or number of lobes is not the model's."""
        quantity = self.card_["quantity"]
        if recording.quantity != quantity:
            raise ValueError(
                f"quantity of the recording is {recording.quantity}, but the model was trained on "
                f"{quantity}: load_default_model({recording.quantity!r}) counts it, or leave out --model"
            )
        # 15 is the default of recordings that do not state their lobes.
        if recording.n_lobes not in (15, self.n_lobes_):
            raise ValueError(
                f"n_lobes of the recording is {recording.n_lobes}, but the model was trained for discs of "
                f"{self.n_lobes_}: train a model on a rig of such discs, cyclofeat train --rig FILE, with "
                f"n_pins {recording.n_lobes + 1} in its gearbox"
            )

    def windows(self, recording: Recording) -> WindowSet:
        """Cut a recording into the windows that the counter takes.

        Parameters
        ----------
        recording : Recording

        Returns
        -------
        WindowSet
        """
        check_is_fitted(self)
        self._check_recording(recording)
        model = self.suited_to(recording)
        return model.windower_.windows([recording], [turning_of(recording, self.n_lobes_).angle])

    def count(self, recording: Recording) -> LobeCount:
        """Count and locate the worn lobes of one recording.

        The probabilities of the windows are combined by the dependence learned in training; a counter
        without one is taken to be no surer of many windows than of one. Windows whose signal has a fault, or
        that lie far outside the training domain, are left out. The recording is refused where more than half
        of its windows are, where their median lies outside the domain, where some are left out and at most
        half of all have its count, where the windows disagree, where its speed lies outside those of
        training, or where, without a tachometer, its lines are those of another speed or show none; it still
        has a count.

        Parameters
        ----------
        recording : Recording
            A recording of the model's quantity and disc, at least one window long.

        Returns
        -------
        LobeCount
        """
        if not isinstance(recording, Recording):
            raise TypeError(f"recording must be a Recording object, got {type(recording).__name__}")
        check_is_fitted(self)
        model = self.suited_to(recording)
        return model._count_prepared([model._prepare_windows(recording)])[0]

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
        """
        if isinstance(recordings, Recording):
            raise TypeError("recordings must be a list of Recording objects, got one: use count")
        check_is_fitted(self)
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
                prepared = suited._prepare_windows(recording)
            except ValueError as error:
                raise ValueError(f"recording {place}: {error}") from error
            if suited is not model or n_samples >= _BATCH_SAMPLES:
                answers += model._count_prepared(batch)
                model, batch, n_samples = suited, [], 0
            batch.append(prepared)
            n_samples += prepared.windows.X.size
        return answers + model._count_prepared(batch)

    def _prepare_windows(self, recording: Recording) -> PreparedWindows:
        """Cut a recording that suits the model into windows, and look for faults."""
        self._check_recording(recording)
        recording = recording.for_counting()
        turning = turning_of(recording, self.n_lobes_)
        windows = self.windower_.windows([recording], [turning.angle])
        notes = [turning.note] if turning.note else []
        # A count does not depend on the load, but unit and scale may be wrong.
        loads = self.card_.get("loads_nm")
        if loads and recording.quantity in TORQUES:
            factor = factor_to_output(recording.quantity, self.n_lobes_)
            low, high = sorted(abs(load) / factor for load in loads)
            low = low if min(loads) * max(loads) > 0 else 0.0
            mean = abs(float(recording.torque.mean()))
            # A mean below the ripple may have been removed.
            if high > 0 and mean >= recording.torque.std() and not low / _FAR <= mean <= high * _FAR:
                notes.append(
                    f"the mean torque, {mean:.4g} Nm, is far from the {low:.3g} to {high:.3g} Nm of the "
                    "training: are unit and scale right?"
                )
        length = windows.X.shape[1], windows.sampling_rate
        stops = ends_by_angle(windows.start_angle, *length, turning.angle, recording.sampling_rate)
        faults = window_faults(recording, windows, stops, self.n_lobes_)
        doubt = turning.doubt or self._untrained_speed(turning.speed_hz)
        is_sure = not turning.note
        # A worn disc that turns at 15/8 of the speed would have larger lines there. At the output, rotor and
        # torque meter may hide them.
        if not is_sure and recording.quantity == "input_torque":
            _, even_rms = shaft_lines(windows.X, windows.sampling_rate, self.n_lobes_)
            is_sure = even_rms < SMALL * abs(float(recording.torque.mean()))
        known = doubt, tuple(notes), float(windows.start_angle[0]), is_sure
        return PreparedWindows(windows, stops, faults, *known)

    def _count_prepared(self, batch: Sequence[PreparedWindows]) -> list[LobeCount]:
        """Count recordings, their windows together."""
        return [
            self._count_of(answered, prepared.doubt, prepared.notes, absolute=prepared.absolute)
            for prepared, answered in zip(batch, self._answer_windows(batch), strict=True)
        ]

    def _count_of(
        self, answered: AnsweredWindows, doubt: str, first_notes: Sequence[str], *, absolute: bool
    ) -> LobeCount:
        """Combine the answers for all windows of a recording."""
        notes = list(first_notes)
        classes = self.counter_.classes_
        distance, n_outside = float(np.median(answered.distance)), int(np.sum(answered.distance > 1))
        reason, reasons = answered.find_refusals(doubt)
        reason = reason or disagreement_reason(answered.proba, answered.faults)
        used = np.array([not one for one in reasons])
        used |= not used.any()
        learned = getattr(self._deciding_part, "dependence_", None)
        probability = pool_windows(answered.proba[used], learned)
        if self.wear_ is None and not reason:
            reason = outvoted_reason(answered.proba, answered.faults, reasons, int(probability.argmax()))
        runs = None if self.wear_ is None or reason else answered.runs
        if self.wear_ is not None and runs is not None:
            probability = self.wear_.probability(runs)
        elif self.wear_ is not None and not reason:
            turns = number_of(self.wear_.n_windows, "output turn")
            notes.append(
                f"no depth of wear, and a less accurate count: {turns} in a row of one recording are needed"
            )
        count = int(classes[probability.argmax()])
        n_windows = len(answered.proba)
        if any(answered.faults) and not reason:
            left_out = f"{sum(map(bool, answered.faults))} of {number_of(n_windows, 'window')} left out"
            notes.append(f"{left_out}: {most_frequent(answered.faults)}")
        if n_outside:
            notes.append(
                f"{n_outside} of {n_windows} window{'s' if n_windows > 1 else ''} {OUTSIDE}: "
                f"{distance:.2f} times the largest distance inside{' (median)' if n_windows > 1 else ''}; "
                "a model trained on your own rig knows it"
            )
        share = answered.mean_lobe_proba(used)
        lobes = sorted(np.argsort(-share, kind="stable")[:count].tolist())
        if not absolute and lobes:
            notes.append(
                "positions are relative: without an absolute angle they count from the lobe under load at "
                "the first sample counted"
            )
        if probability.max() < 0.5 and not reason:
            alone = f"no count reaches a probability of one half: {count} has {probability.max():.2f}"
            # Where a depth is stated, wear is seen although its lobes are hard to count.
            if runs is None:
                reason = alone
            else:
                notes.append(alone)
        if count == 0 and self.wear_ is None and not reason:
            notes.append("fainter wear than in training may not show")
        if not self.card_.get("calibrated", False):
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
            windows=answered.window_counts(classes, reasons),
            wear_um=None if self.wear_ is None or runs is None else self.wear_.depth_of(runs, count),
        )

    def _answer_windows(self, batch: Sequence[PreparedWindows]) -> list[AnsweredWindows]:
        """Answer for the windows of several recordings together."""
        if not batch:
            return []
        X = np.concatenate([prepared.windows.X for prepared in batch])
        # Lobe lines and features take most of the time: locator and domain reuse those of the counter.
        counter, lines = self.counter_, None
        is_sound, denied = np.zeros((2, len(X)), dtype=bool)
        if isinstance(counter, LobeCounter):
            lines = counter.lobe_map_.lines(X)
            features = counter.lobe_map_.from_lines(lines)
            proba = counter._proba_of_lines(lines, features)
            if self.classes_.tolist()[0] == 0:
                alone, clear = tell_wear(features, self.n_lobes_)
                is_sound = alone & getattr(self, "alone_is_sound_", True)
                proba[is_sound] += _SURELY_SOUND * ((counter.classes_ == 0) - proba[is_sound])
                refutes = self.wear_ is None and getattr(self, "lines_are_worn_", True)
                denied = clear & (proba.argmax(axis=1) == 0) & refutes
        elif isinstance(counter, Pipeline) and len(counter) > 1:
            transformed = counter[:-1].transform(X)
            proba, features = np.asarray(counter[-1].predict_proba(transformed)), np.asarray(transformed)
        else:
            proba = np.asarray(counter.predict_proba(X))
            features = features_seen(counter, X)
        distances, unlike = np.full(len(X), np.nan), [OUTSIDE] * len(X)
        if self.domain_ is not None:
            limit = [_QUIET if prepared.is_sure else 1.0 for prepared in batch for _ in prepared.faults]
            distances = self.domain_.distance(features) / np.where(is_sound, limit, 1.0)
            outside = np.flatnonzero(distances > 1)
            names = feature_words(counter, features.shape[1]) if outside.size else []
            ranks = self.domain_._rank_unlike(features[outside]).tolist() if outside.size else []
            for place, rank in zip(outside.tolist(), ranks, strict=True):
                # The two lines or slots by which it differs most from the training.
                words = " and ".join([*dict.fromkeys(names[at] for at in rank)][:2])
                unlike[place] = f"{OUTSIDE}: {distances[place]:.2f} times the limit, most by {words}"
        unlike = np.where(denied, DENIED, unlike).tolist()
        ends = [0, *np.cumsum([len(prepared.windows) for prepared in batch]).tolist()]
        rows = [slice(start, stop) for start, stop in pairwise(ends)]
        located: Sequence[Float | None] = [None] * len(batch)
        if lines is not None and self.locator_ is not None:
            located = self._lobe_proba(self.locator_, batch, lines, rows, proba)
        wear = self.wear_
        return [
            AnsweredWindows(
                prepared.windows.start_s,
                prepared.stop_s,
                proba[row],
                distances[row],
                prepared.faults,
                tuple(unlike[row]),
                lobes,
                None
                if wear is None
                else wear.answers(prepared.windows.X, prepared.faults, breaks_between(prepared.windows)),
            )
            for prepared, row, lobes in zip(batch, rows, located, strict=True)
        ]

    @property
    def _deciding_part(self) -> Any:
        """The counter, or what decides behind a lobe map, which learns nothing from other windows."""
        counter = self.counter_
        if isinstance(counter, Pipeline) and isinstance(counter[0], LobeMap) and len(counter) == 2:
            return counter[1]
        return counter

    def _untrained_speed(self, speed_hz: float) -> str:
        """Return why a mean speed of the input shaft is not one of training; else empty."""
        low, high = self.card_["speeds_rpm"]
        rpm = 60 * speed_hz
        if low * (1 - SPEED_MARGIN) <= rpm <= high * (1 + SPEED_MARGIN):
            return ""
        return f"it turns at {rpm:.5g} RPM, but the model was trained at {_range_text((low, high))} RPM"

    def _lobe_proba(
        self, locator: LobeCounter, batch: Sequence[PreparedWindows], lines: LobeLines,
        rows: Sequence[slice], of_counts: Float,
    ) -> list[Float]:  # fmt: skip
        """Return the probability of each lobe, numbered as on the disc or from the first sample.

        Each of shape (n_places, n_windows, n_lobes), see :class:`AnsweredWindows`.
        """
        begins: list[Float] = []
        for prepared in batch:
            windows = prepared.windows
            if prepared.absolute:
                begins.append(passage_of_lobe_zero(windows.start_angle, self.n_lobes_)[np.newaxis])
                continue
            # Windows are aligned by the input turns between them.
            turned = (windows.start_angle - prepared.first_angle) / (2 * np.pi)
            places = np.arange(_START_PLACES)[:, np.newaxis] / (_START_PLACES * self.n_lobes_)
            begins.append(places - lobe_frequency(1.0, self.n_lobes_) * turned)
        repeated = [
            np.tile(np.arange(row.start, row.stop), len(b)) for b, row in zip(begins, rows, strict=True)
        ]
        passages = np.concatenate([places.ravel() for places in begins])
        row_of = np.concatenate(repeated)
        proba = locator._lobe_proba_of_lines(
            LobeLines(*(column[row_of] for column in lines)), passages, of_counts[row_of]
        )
        parts = np.split(proba, np.cumsum([places.size for places in begins])[:-1])
        return [part.reshape(*places.shape, -1) for part, places in zip(parts, begins, strict=True)]


def _label_recordings(
    recordings: Sequence[Recording], y: ArrayLike | None, groups: ArrayLike | None
) -> tuple[list[Recording], dict[int, Any]]:
    """Return recordings that all state their count, and the label of each count."""
    known = list(recordings)
    if groups is not None:
        names = of_windows("groups", groups, len(known), "recording").tolist()
        known = [one.replace(assembly=name) for one, name in zip(known, names, strict=True)]
    labels = [one.defect_count for one in known]
    if y is not None:
        labels = of_windows("y", y, len(known), "recording").tolist()
    if None in labels:
        raise ValueError("recordings must all state their defect_count to train on, some do not")
    known = [
        recording if recording.defect_count is not None else recording.replace(defect_count=label)
        for recording, label in zip(known, labels, strict=True)
    ]
    # cross_val_predict numbers the classes for predict_proba: other labels of the same counts.
    counts = [int(recording.defect_count or 0) for recording in known]
    label_of = dict(zip(counts, labels, strict=True))
    if [label_of[count] for count in counts] != labels or len({*labels}) < len(label_of):
        raise ValueError("y contradicts the defect_count of recordings: leave one of them out")
    return known, label_of


def _value_range(values: Sequence[float]) -> list[float] | None:
    """Return the least and the largest value; None for an empty sequence."""
    return [float(min(values)), float(max(values))] if values else None


def _range_text(ends: Sequence[float]) -> str:
    low, high = (f"{end:.4g}" for end in ends)
    return low if low == high else f"{low} to {high}"
