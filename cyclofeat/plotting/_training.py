"""Picture of a recording's features beside those of the training windows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from cyclofeat.features import LobeMap
from cyclofeat.plotting.drawing import (
    Display,
    Float,
    axes_for,
    legend_above,
    numbering_words,
    theme_colours,
    words_of,
)
from cyclofeat.recordings import Recording, WindowSet
from cyclofeat.signal import lobes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from cyclofeat.counting import LobeModel

# Fewest columns of one kind, like 15 slots or 44 lines, that are drawn as a course.
_FEWEST_COLUMNS = 3


class TrainingDisplay(Display):
    """Features of a recording's windows beside those of the training windows of some counts.

    Parameters
    ----------
    model : cyclofeat.counting.LobeModel
        With a training domain.
    recording : Recording
        See :meth:`cyclofeat.counting.LobeModel.count`.

    Attributes
    ----------
    features : ndarray, shape (n_windows, n_features)
        Features of the recording's windows.
    names : list of str
        Names of the features, ``kind(place)``; one kind is drawn together. If empty, none are drawn.
    classes, means, spread : ndarray, shapes (n_classes,), (n_classes, n_features) and (n_features,)
        Of the training windows: the counts, the mean of each, the standard deviation about these means.
    slot_lobes : ndarray of int, shape (n_lobes,), or None
        Lobe, from 0, whose passage lies nearest to each slot of a :class:`cyclofeat.features.LobeMap`: the
        labels of slots.
    absolute : bool
        True if these are numbers on the disc, False if they count from the recording's first sample.

    Raises
    ------
    ValueError
        If the model has no domain, or the recording does not suit it.

    See Also
    --------
    cyclofeat.counting.TrainingDomain : How far a recording lies from its training windows.

    Examples
    --------
    >>> display = TrainingDisplay(model, recording)  # doctest: +SKIP
    >>> display.plot(kind=display.kinds[0], counts=(1, 0))  # doctest: +SKIP
    """

    def __init__(self, model: LobeModel, recording: Recording) -> None:
        from cyclofeat.counting.calibration.training_domain import features_seen
        from cyclofeat.counting.evaluation.assembly_folds import estimators_in
        from cyclofeat.models.card import feature_definitions

        model = model.suited_to(recording)
        domain, counter = model.domain_, model.counter_
        if domain is None:
            raise ValueError("model must have a domain to compare with, got one without (one assembly only?)")
        windows = model.windows(recording)
        self.features: Float = np.asarray(features_seen(counter, windows.X))
        names = feature_definitions(counter)["columns"]
        self.names: list[str] = names if len(names) == self.features.shape[1] else []
        self.classes: NDArray[Any] = counter.classes_
        self.means: Float = domain.means_ * domain.scale_ + domain.location_
        self.spread: Float = np.sqrt(np.diag(np.linalg.inv(domain.precision_))) * domain.scale_
        lobe_map = next((part for part in estimators_in(counter) if isinstance(part, LobeMap)), None)
        self.slot_lobes = None if lobe_map is None else _slot_lobes(lobe_map, windows)
        self.absolute = bool(windows.absolute[0])

    @property
    def _columns(self) -> dict[str, NDArray[np.intp]]:
        """Columns of each kind, whose names are ``kind(place)``."""
        kinds = np.array([name.partition("(")[0] for name in self.names])
        return {kind: np.flatnonzero(kinds == kind) for kind in dict.fromkeys(kinds.tolist())}

    @property
    def kinds(self) -> list[str]:
        """Kinds of features that can be drawn, the best at separating counts first."""
        spread = np.where(self.spread > 0, self.spread, np.inf)
        separation = (np.ptp(self.means, axis=0) / spread) ** 2
        columns = {kind: at for kind, at in self._columns.items() if at.size >= _FEWEST_COLUMNS}
        return sorted(columns, key=lambda kind: -float(separation[columns[kind]].mean()))

    def plot(
        self, ax: Axes | None = None, *, kind: str | None = None, counts: tuple[int, ...] | None = None
    ) -> Self:
        """Draw the course of the features of one kind over their places (slots, lines).

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        kind : str, optional
            One of :attr:`kinds`; default, the first.
        counts : tuple of int, optional
            Counts whose training windows are drawn, the first with its spread; default, all.

        Returns
        -------
        self : TrainingDisplay

        Raises
        ------
        ValueError
            If the kind or a count is unknown, or there is no kind.
        """
        kinds = self.kinds
        kind = kinds[0] if kind is None and kinds else kind
        if kind not in kinds:
            raise ValueError(f"kind must be one of {kinds}, got {kind!r}")
        shown = self.classes.tolist() if counts is None else list(counts)
        unknown = [count for count in shown if count not in self.classes]
        if unknown:
            raise ValueError(f"counts must be of {self.classes.tolist()}, got {unknown[0]!r}")
        self.figure_, self.ax_ = axes_for(ax, (7.0, 3.0))
        columns = self._columns[kind]
        places = np.arange(1, columns.size + 1)
        for number, count in enumerate(shown):
            row = int(np.flatnonzero(self.classes == count)[0])
            mean, colour = self.means[row, columns], f"C{number}"
            label, style = f"trained: {count} worn", "--"
            if number == 0:
                low, high = mean - self.spread[columns], mean + self.spread[columns]
                self.ax_.fill_between(places, low, high, color=colour, alpha=0.25, linewidth=0)
                label, style = f"{label} (one std)", "-"
            self.ax_.plot(places, mean, style, color=colour, linewidth=1.2, label=label)
        recorded = np.median(self.features[:, columns], axis=0)
        self.ax_.plot(
            places, recorded, linestyle="", marker="o", markersize=3.5, color=theme_colours()[0],
            label="this recording",
        )  # fmt: skip
        words = words_of(kind)
        self.ax_.set(xlabel=words.places, ylabel=words.axis, xlim=(0.5, columns.size + 0.5))
        if kind.startswith("lobe_slot") and self.slot_lobes is not None:
            self.ax_.set_xticks(places, [str(lobe + 1) for lobe in self.slot_lobes])
            self.ax_.set_xlabel(f"lobe, {numbering_words(self.absolute)}")
        self.ax_.grid(axis="y", alpha=0.3, linewidth=0.6)
        legend_above(self.ax_, ncols=3)
        return self


def _slot_lobes(lobe_map: LobeMap, windows: WindowSet) -> NDArray[np.int64]:
    """Return the lobe, from 0, that passes nearest to each slot of the first window."""
    from cyclofeat.counting import passage_of_lobe_zero

    n = lobe_map.n_lobes
    begin = 0.0
    if lobe_map.align == "energy":
        folded = lobes.fold(lobe_map.lines(windows.X[:1]).lines, n)
        begin = float(lobes.energy_centre(folded)[0]) - 0.5
    # Without an absolute angle the lobe under load at the first sample fills the first slot from there on.
    passage = 0.5 / n
    if windows.absolute[0]:
        passage = float(passage_of_lobe_zero(windows.start_angle[:1], n)[0])
    middle = begin + (np.arange(n) + 0.5) / n
    return np.rint(n * (middle - passage)).astype(np.int64) % n
