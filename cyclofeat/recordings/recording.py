"""One torque record with its labels."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from scipy.signal import resample_poly

from cyclofeat._base import checks, displays, draw_plot
from cyclofeat._base.checks import is_whole, number, number_series, one_of, positive, truth_value, whole
from cyclofeat._base.displays import Card, WithCard, data_frame
from cyclofeat._base.quantities import (
    CHANNELS,
    QUANTITIES,
    QUANTITY_UNITS,
    from_1,
    in_words,
    lobes_text,
    source_in_words,
)
from cyclofeat.signal.windows import LARGEST, Float, high_pass

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

Label = str | int
_LARGEST_RATIO = 10_000  # numbers of the ratio of two sampling rates


@dataclass(frozen=True, eq=False)
class Recording(checks.Replaceable, WithCard):
    """One record of output torque, input torque or motor current, with what is known about it.

    Parameters
    ----------
    torque : array_like of shape (n,)
        Samples of the quantity, in Nm; a motor current in A, or in the unit in ``meta["unit"]``: "Nm" where a
        torque constant scaled it, "%" or "p.u." of the rated current. Real, finite, within +-1e100, at least
        two samples. Copied, then read-only.
    sampling_rate : float
        Samples per second, in Hz.
    quantity : {"output_torque", "input_torque", "motor_current"}, default "output_torque"
        Quantity that was recorded.
    angle : array_like of shape (n,), optional
        Shaft angle in rad at the same moments, strictly increasing (unwrapped). A disc's angle may also fall;
        see Notes.
    angle_of : {"input", "disc"}, default "input"
        Shaft that the tachometer was on.
    angle_is_absolute : bool, default False
        Whether the angle's zero is known: for the input, cam 0 at pin 0 with the discs in their rest position
        (theta_1 = -pi/15); for the disc, the tip of lobe 0 of wheel 0 at pin 0 (theta_1 = 0). Where it is
        not, positions of lobes are relative.
    assembly : str or int, optional
        The gearbox as assembled: all recordings of one assembly belong together in cross-validation.
    run : str or int, optional
        Name of this recording.
    defect_count : int, optional
        Number of distinct worn lobes. Follows from ``worn_lobes`` where it is not given.
    worn_lobes : sequence of int, optional
        Worn lobes, counted from 0.
    n_lobes : int, default 15
        Lobes of a disc: ``worn_lobes`` lie below it, and ``defect_count`` is at most as large.
    speed_rpm : float, optional
        Nominal speed of the input shaft in turns per minute.
    load_nm : float, optional
        Nominal load torque in Nm.
    source : str, optional
        Where the record comes from, e.g. "measured", "simulated", "surrogate".
    meta : mapping of str, optional
        Anything else that is known. Copied; {} where it is not given.

    Notes
    -----
    While the input turns counter-clockwise (phi rises), the disc turns clockwise, 15 times slower:
    theta_1 = -(phi + pi)/15. A disc angle that falls is taken for theta_1, one that rises for -theta_1.

    Examples
    --------
    >>> import numpy as np
    >>> torque = 22 + 0.1 * np.sin(np.arange(51_200))
    >>> recording = Recording(torque, 25_600, assembly="A1", worn_lobes=(0, 4), speed_rpm=500)
    >>> recording.duration, recording.n_samples, recording.defect_count
    (2.0, 51200, 2)
    """

    torque: Float = field(repr=False)
    sampling_rate: float
    _: KW_ONLY
    quantity: str = "output_torque"
    angle: Float | None = field(default=None, repr=False)
    angle_of: Literal["input", "disc"] = "input"
    angle_is_absolute: bool = False
    assembly: Label | None = None
    run: Label | None = None
    defect_count: int | None = None
    worn_lobes: tuple[int, ...] | None = None
    n_lobes: int = 15
    speed_rpm: float | None = None
    load_nm: float | None = None
    source: str | None = None
    meta: Mapping[str, Any] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            "torque": _checked_samples("torque", self.torque),
            "sampling_rate": positive("sampling_rate", self.sampling_rate, "a number (Hz)"),
            "quantity": one_of("quantity", self.quantity, QUANTITIES),
            "angle_is_absolute": truth_value("angle_is_absolute", self.angle_is_absolute),
            "assembly": _checked_label("assembly", self.assembly),
            "run": _checked_label("run", self.run),
            "n_lobes": whole("n_lobes", self.n_lobes, 2),
            "source": None if self.source is None else _checked_text("source", self.source),
            "angle_of": one_of("angle_of", self.angle_of, ("input", "disc")),
        }
        meta = {} if self.meta is None else self.meta
        if not isinstance(meta, Mapping) or not all(isinstance(key, str) for key in meta):
            raise TypeError(f"meta must be a mapping with text as keys, got {checks.repr_of(meta)}")
        checked["meta"] = dict(meta)
        for name in {"bad_spans", "gaps"} & meta.keys():
            for pair in meta[name]:
                checks.number_pair(f"{name} of meta", pair)
        if self.speed_rpm is not None:
            checked["speed_rpm"] = positive("speed_rpm", self.speed_rpm, "a number (RPM)")
        if self.load_nm is not None:
            checked["load_nm"] = number("load_nm", self.load_nm, "a number (Nm)")
        checked["worn_lobes"], checked["defect_count"] = _checked_defects(
            self.worn_lobes, self.defect_count, checked["n_lobes"]
        )
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if self.angle is not None:
            object.__setattr__(self, "angle", self._checked_angle())
        elif self.angle_is_absolute:
            raise ValueError("angle_is_absolute=True is wrong: the recording has no angle")

    def _checked_angle(self) -> Float:
        angle = _checked_samples("angle", self.angle)
        if angle.size != self.torque.size:
            raise ValueError(
                f"angle must have torque's length, got {angle.size} for {self.torque.size} samples"
            )
        falls = self.angle_of == "disc" and angle[-1] < angle[0]
        steps = -np.diff(angle) if falls else np.diff(angle)
        if not np.all(steps > 0):
            direction = "fall" if falls else "rise"
            where = int(np.argmax(steps <= 0))
            raise ValueError(
                f"angle must {direction} strictly, in rad; got {angle[where]:.6g} at sample {where} and "
                f"{angle[where + 1]:.6g} at sample {where + 1} (an angle that starts again at each turn: "
                "numpy.unwrap)"
            )
        if self.input_speed_hz is not None:
            # Too slow may be a start from rest; too fast is a wrong unit, or the wrong shaft (no disc turns
            # at a fifth of the input's speed).
            limit = self.input_speed_hz * (2 if self.angle_of == "input" else 0.2)
            speed = float(np.median(steps)) * self.sampling_rate / (2 * math.pi)
            if speed > limit:
                raise ValueError(
                    f"angle must agree with speed_rpm: it turns {speed:.4g} times per second (median), the "
                    f"input at {self.speed_rpm:g} RPM {self.input_speed_hz:.4g} times; is it in rad, and is "
                    f"angle_of = {self.angle_of!r} right?"
                )
        return angle

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Recording):
            return NotImplemented
        return _are_equal(vars(self), vars(other))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        for name in ("torque", "angle"):
            if state[name] is not None:
                # Pickles forget it.
                state[name].flags.writeable = False

    @classmethod
    def from_run(
        cls, run: Any, /, *, quantity: str = "output_torque", with_angle: bool = True, **labels: Any
    ) -> Recording:
        """Make a recording of a simulated run.

        Parameters
        ----------
        run : object
            Result of a simulation with the quantity and ``input_angle`` (rad) of shape (n,),
            ``sampling_rate`` (Hz), ``defects`` (``defect_count``, ``worn_lobes``) and ``gearbox``
            (``input_speed`` in rad/s, ``load_torque`` in Nm).
        quantity : {"output_torque", "input_torque", "motor_current"}, default "output_torque"
            Quantity to record: the run's ``torque_out`` (Nm), ``torque_in`` (Nm) or ``motor_current`` (A).
        with_angle : bool, default True
            Whether to keep the input angle, which is absolute. False: a recording without a tachometer.
        **labels
            Any other parameter of :class:`Recording`; those given here replace the run's own.

        Returns
        -------
        Recording
            With ``source="simulated"`` where no other is given. Where lobes are removed, ``defect_count``
            counts them too; ``worn_lobes`` is then None, since removed lobes are not worn ones, and ``meta``
            holds both as ``"worn_lobes_from_1"`` and ``"removed_lobes_from_1"``, as files do.

        Examples
        --------
        >>> from types import SimpleNamespace
        >>> run = SimpleNamespace(
        ...     torque_out=[21.9, 22.1, 22.0], sampling_rate=25_600, input_angle=[0.0, 0.002, 0.004],
        ...     defects=SimpleNamespace(defect_count=1, worn_lobes=(3,)),
        ...     gearbox=SimpleNamespace(input_speed=52.36, load_torque=22.0),
        ... )
        >>> recording = Recording.from_run(run, assembly="A1")
        >>> recording.worn_lobes, recording.source, recording.angle_is_absolute
        ((3,), 'simulated', True)
        """
        attribute = CHANNELS[one_of("quantity", quantity, QUANTITIES)]
        samples = getattr(run, attribute, None)
        if samples is None:
            raise ValueError(
                f"quantity must be one that the run holds, got {quantity!r}, but {attribute} is None"
            )
        known: dict[str, Any] = {
            "quantity": quantity,
            "defect_count": run.defects.defect_count,
            # rad/s and back leaves a residue in the last digits
            "speed_rpm": round(run.gearbox.input_speed * 60 / (2 * math.pi), 6),
            "load_nm": run.gearbox.load_torque,
            "n_lobes": getattr(run.gearbox, "n_lobes", 15),
            "source": "simulated",
        }
        removed, meta = tuple(getattr(run.defects, "removed_lobes", ())), {}
        if not removed:
            known["worn_lobes"] = run.defects.worn_lobes
        elif not {"defect_count", "worn_lobes"} & labels.keys():
            meta["worn_lobes_from_1"] = from_1(run.defects.worn_lobes)
            meta["removed_lobes_from_1"] = from_1(removed)
        if (wear_um := getattr(run.defects, "wear_um", None)) is not None:
            meta["wear_um"] = np.asarray(wear_um if run.defects.worn_lobes else 0.0).tolist()
        labels["meta"] = meta | dict(labels.get("meta") or {})
        if with_angle:
            known |= {"angle": run.input_angle, "angle_of": "input", "angle_is_absolute": True}
        if "worn_lobes" in labels:
            del known["defect_count"]  # follows from the lobes, unless it is given too
        elif "defect_count" in labels:
            known.pop("worn_lobes", None)
        return cls(samples, run.sampling_rate, **(known | labels))

    @property
    def unit(self) -> str:
        """Unit of the samples: ``meta["unit"]`` where stated, else Nm, and A for a motor current."""
        return str((self.meta or {}).get("unit", QUANTITY_UNITS[self.quantity]))

    @property
    def bad_spans(self) -> tuple[tuple[float, float], ...]:
        """Beginning and end in s of the spans that :meth:`with_bad_spans` marked."""
        return tuple((start, stop) for start, stop in (self.meta or {}).get("bad_spans", ()))

    @property
    def gaps(self) -> tuple[tuple[int, float], ...]:
        """Number of the sample behind each gap, and of samples that are missing there; 0 at a seam."""
        return tuple((int(at), n) for at, n in (self.meta or {}).get("gaps", ()))

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.torque.size)

    @property
    def duration(self) -> float:
        """Number of samples over the sampling rate, in s."""
        return self.n_samples / self.sampling_rate

    @property
    def input_speed_hz(self) -> float | None:
        """Nominal input speed in turns per second; None where ``speed_rpm`` is not known."""
        return None if self.speed_rpm is None else self.speed_rpm / 60

    def input_angle(self, reduction: int | None = None) -> Float | None:
        """Return the increasing angle phi of the input shaft in rad; None for a recording without an angle.

        Parameters
        ----------
        reduction : int, optional
            Input turns per turn of the disc, used where ``angle_of`` is "disc". Default: ``n_lobes``.

        Returns
        -------
        ndarray, shape (n_samples,), or None
        """
        if self.angle is None or self.angle_of == "input":
            return self.angle
        falls = self.angle[-1] < self.angle[0]
        turns = self.n_lobes if reduction is None else reduction
        # The rest position theta_1 = -(phi + pi) / turns, solved for phi.
        return np.asarray(-turns * (self.angle if falls else -self.angle) - math.pi)

    def mean_input_speed(self, reduction: int | None = None) -> float | None:
        """Return the mean speed of the input shaft in turns per second; None without an angle.

        Parameters
        ----------
        reduction : int, optional
            See :meth:`input_angle`.

        Returns
        -------
        float or None
        """
        angle = self.input_angle(reduction)
        if angle is None:
            return None
        seams = np.array([at for at, missing in self.gaps if not missing], dtype=int)
        turned = angle[-1] - angle[0] - np.sum(angle[seams] - angle[seams - 1])
        return float(turned / (2 * math.pi * (angle.size - 1 - seams.size)) * self.sampling_rate)

    def crop(self, start_s: float = 0.0, stop_s: float | None = None) -> Recording:
        """Return a part of the recording, with all labels.

        Parameters
        ----------
        start_s, stop_s : float, optional
            Beginning and end in s. Default: those of the recording.

        Returns
        -------
        Recording

        Examples
        --------
        >>> Recording(range(100), 50).crop(0.5, 1.5).torque[[0, -1]]
        array([25., 74.])
        """
        end = self.duration if stop_s is None else stop_s
        rows = slice(*(round(moment * self.sampling_rate) for moment in (max(start_s, 0.0), end)))
        torque = self.torque[rows]
        if not 0 <= start_s < end or torque.size < 2:
            raise ValueError(
                f"start_s and stop_s must enclose 2 samples or more of the {self.duration:g} s recorded, "
                f"got {start_s:g} and {end:g} s"
            )
        rate, size = self.sampling_rate, torque.size
        gaps = [[at - rows.start, n] for at, n in self.gaps]
        spans = np.clip(np.reshape(self.bad_spans, (-1, 2)) - rows.start / rate, 0.0, size / rate).tolist()
        return self._with_step(
            f"crop({start_s:g}, {end:g})",
            gaps=[gap for gap in gaps if 0 < gap[0] < size],
            bad_spans=[span for span in spans if span[0] < size / rate and span[1] > 0],
            torque=torque,
            angle=None if self.angle is None else self.angle[rows],
        )

    def resample(self, sampling_rate: float) -> Recording:
        """Return the recording at another sampling rate, by :func:`scipy.signal.resample_poly`.

        The angle is interpolated linearly: a filter would bend it. Bad spans become straight lines.

        Parameters
        ----------
        sampling_rate : float
            In Hz; its ratio to the recording's is one of whole numbers up to 10,000.

        Returns
        -------
        Recording

        Examples
        --------
        >>> Recording(range(2000), 1000).resample(400).n_samples
        800
        """
        rate = positive("sampling_rate", sampling_rate, "a number (Hz)")
        ratio = Fraction(rate / self.sampling_rate).limit_denominator(_LARGEST_RATIO)
        n_samples = int((self.n_samples - 1) * ratio) + 1
        exact = math.isclose(ratio * self.sampling_rate, rate, rel_tol=1e-9)
        if not exact or ratio.numerator > _LARGEST_RATIO or n_samples < 2:
            raise ValueError(
                f"sampling_rate must leave 2 samples or more, in a ratio of whole numbers up to "
                f"{_LARGEST_RATIO} to the recording's {self.sampling_rate:g} Hz, got {rate!r} Hz"
            )
        torque = resample_poly(self._bridge_torque(), ratio.numerator, ratio.denominator, padtype="line")
        at = np.arange(n_samples) / float(ratio)
        angle = None if self.angle is None else np.interp(at, np.arange(self.n_samples), self.angle)
        gaps = [[round(at * ratio), float(n * ratio)] for at, n in self.gaps]
        changes = {"torque": torque[:n_samples], "angle": angle, "sampling_rate": rate, "gaps": gaps}
        return self._with_step(f"resample({rate:g})", **changes)

    def high_pass(self, cutoff_hz: float) -> Recording:
        """Return the recording without mean and slow drift, by :func:`cyclofeat.signal.high_pass`.

        Bad spans become straight lines. :class:`Windower`, and with it all models, adds the mean again, which
        tells load and direction.

        Parameters
        ----------
        cutoff_hz : float
            In Hz; for a count, below the lobes' passage at 16/15 of the input speed.

        Returns
        -------
        Recording
            With the mean that was removed as ``meta["removed_mean"]``.

        Examples
        --------
        >>> round(Recording([22.0, 23.0] * 500, 1000).high_pass(1.0).meta["removed_mean"], 1)
        22.5
        """
        whole = self.for_counting().torque
        torque = high_pass(whole, self.sampling_rate, cutoff_hz)
        removed = float(whole.mean() - torque.mean())
        return self._with_step(f"high_pass({cutoff_hz:g})", torque=torque, removed_mean=removed)

    @classmethod
    def concatenate(cls, recordings: Iterable[Recording]) -> Recording:
        """Join recordings of one gearbox end to end.

        Each seam is a gap, and a bad span of no length: no window holds samples of both sides.

        Parameters
        ----------
        recordings : iterable of Recording
            With the same rate, quantity and labels, except ``run``, ``source`` and ``meta``, of which the
            first one's stay. Angles that are not absolute must go on from one recording to the next; whole
            output turns between two recordings are left out.

        Returns
        -------
        Recording

        Examples
        --------
        >>> recording = Recording(range(100), 50)
        >>> Recording.concatenate([recording.crop(0, 0.5), recording.crop(1.5)]).bad_spans
        ((0.5, 0.5),)
        """
        records = list_recordings(recordings)
        own = {"torque", "_", "angle", "run", "source", "meta"}
        for name in ["unit", *sorted({part.name for part in dataclasses.fields(cls)} - own)]:
            _common_value(records, name, name, None)
        records, first = [record.for_counting() for record in records], records[0]
        angles = [record.angle for record in records if record.angle is not None]
        if 0 < len(angles) < len(records):
            raise ValueError("recordings must all have an angle, or none: replace(angle=None) leaves it out")
        joined, shift = angles[:1], 0.0
        for before, angle in pairwise(angles):
            output_turn = 2 * math.pi * (first.n_lobes if first.angle_of == "input" else 1)
            output_turn = math.copysign(output_turn, angle[-1] - angle[0])
            turns = float(angle[0] - before[-1]) / output_turn
            if turns <= 0 and not first.angle_is_absolute:
                raise ValueError(
                    f"recordings must have an absolute angle, or one that goes on, got {angle[0]:g} behind "
                    f"{before[-1]:g} rad: replace(angle=None) leaves it out"
                )
            shift -= output_turn * (math.ceil(turns) - 1)
            joined.append(angle + shift)
        begins = np.cumsum([0, *(record.n_samples for record in records)])[:-1].tolist()
        gaps = [[begin, 0] for begin in begins[1:]]
        spans = [[begin / first.sampling_rate] * 2 for begin in begins[1:]]
        for begin, record in zip(begins, records, strict=True):
            gaps += [[begin + at, n] for at, n in record.gaps]
            spans += [[begin / first.sampling_rate + end for end in span] for span in record.bad_spans]
        return first._with_step(
            f"concatenate({len(records)})",
            gaps=sorted(gaps),
            bad_spans=sorted(spans),
            torque=np.concatenate([record.torque for record in records]),
            angle=np.concatenate(joined) if joined else None,
        )

    def with_bad_spans(self, spans: Iterable[tuple[float, float]]) -> Recording:
        """Return the recording with more spans marked as bad; no window touches these.

        Parameters
        ----------
        spans : iterable of (start, stop)
            Beginning and end of each in s.

        Returns
        -------
        Recording

        Examples
        --------
        >>> Recording([22.0] * 100, 50).with_bad_spans([(1.8, 9), (0.2, 0.4)]).bad_spans
        ((0.2, 0.4), (1.8, 2.0))
        """
        marked = [list(span) for span in self.bad_spans]
        for span in spans:
            start, stop = checks.number_pair("spans", span, "pairs of numbers (start, stop) in s")
            marked.append([max(start, 0.0), min(stop, self.duration)])
            if not marked[-1][0] < marked[-1][1]:
                raise ValueError(
                    f"spans must begin before they end, within the {self.duration:g} s recorded, got "
                    f"({start:g}, {stop:g}) s"
                )
        return self._with_step("with_bad_spans", bad_spans=sorted(marked))

    def for_counting(self) -> Recording:
        """Return the recording with straight lines in place of bad spans, and with its mean.

        Returns
        -------
        Recording
        """
        removed, bridged = (self.meta or {}).get("removed_mean", 0.0), self._bridge_torque()
        if not removed and bridged is self.torque:
            return self
        counted = self.replace(torque=bridged + removed, meta={**(self.meta or {}), "removed_mean": 0.0})
        vars(counted)["_is_bridged"] = True  # a count asks several times
        return counted

    def _bridge_torque(self) -> Float:
        spans = () if "_is_bridged" in vars(self) else self.bad_spans
        time = np.arange(self.n_samples if spans else 0) / self.sampling_rate
        bad = np.zeros(time.size, dtype=bool)
        for start, stop in spans:
            bad |= (time >= start) & (time < stop)
        return np.interp(time, time[~bad], self.torque[~bad]) if 0 < bad.sum() < bad.size else self.torque

    def _with_step(self, step: str, **changes: Any) -> Recording:
        """Return a copy with other values, or with other entries of ``meta``, and the step in its history."""
        of_meta = {"gaps", "bad_spans", "removed_mean"} & changes.keys()
        meta = {**(self.meta or {}), **{name: changes.pop(name) for name in of_meta}}
        for name in [name for name in of_meta if meta[name] == []]:
            del meta[name]
        return self.replace(meta={**meta, "history": [*meta.get("history", ()), step]}, **changes)

    def to_frame(self) -> pd.DataFrame:
        """Return the samples as a data frame, whose CSV file ``read_recording`` reads.

        Returns
        -------
        pandas.DataFrame
            One row per sample, its time in s as the index; columns are named with their units.

        Examples
        --------
        >>> Recording([22.0, 22.4], 1000, angle=[0.0, 0.05]).to_frame().columns.tolist()
        ['output_torque (Nm)', 'input_angle (rad)']
        """
        time = np.arange(self.n_samples) / self.sampling_rate
        columns = {"time (s)": time, f"{self.quantity} ({self.unit})": self.torque}
        if self.angle is not None:
            columns[f"{self.angle_of}_angle (rad)"] = self.angle
        return data_frame(columns).set_index("time (s)")

    def plot(
        self,
        kind: Literal["torque", "spectrum", "orders", "lobes"] = "torque",
        ax: Axes | None = None,
        **options: Any,
    ) -> Any:
        """Draw the recording.

        Parameters
        ----------
        kind : {"torque", "spectrum", "orders", "lobes"}, default="torque"
            Torque over time, its spectrum, the lines of the output turn, or the disturbance while each lobe
            passes; the last two need a speed.
        ax : matplotlib.axes.Axes, optional
            Axes to draw on; default, new ones.
        **options
            Passed on to ``plot`` of the display.

        Returns
        -------
        TorqueDisplay, SpectrumDisplay, OrderDisplay or LobeMapDisplay
            Of :mod:`cyclofeat.plotting`; with the axes ``ax_`` and the ``figure_``.
        """
        return draw_plot(self, kind, ax, **options)

    def _card(self) -> Card:
        rows, name = facts_in_words(self), in_words(self.quantity)
        title, curves = f"{name.capitalize()} over {self.duration:.4g} s", [displays.Curve(self.torque)]
        return Card(
            f"Recording of {name}", rows, lambda: [displays.draw_curves(curves, title)],
            code='recording.plot("spectrum")',
        )  # fmt: skip


def facts_in_words(recording: Recording) -> dict[str, str | None]:
    """Return what is known about a recording, label to text; None for a label that it lacks."""
    known, torque, unit = "not known", recording.torque, recording.unit
    zero = ", absolute" if recording.angle_is_absolute else ""
    worn = known if recording.defect_count is None else str(recording.defect_count)
    if recording.worn_lobes:
        worn += f": {lobes_text(recording.worn_lobes, recording.n_lobes)}, counted from 1"
    return {
        "length": f"{recording.duration:.4g} s: {recording.n_samples} samples at "
        f"{recording.sampling_rate:g} Hz",
        in_words(recording.quantity): f"{torque.min():.4g} to {torque.max():.4g} {unit}, "
        f"mean {torque.mean():.4g} {unit}",
        "input speed": known if recording.speed_rpm is None else f"{recording.speed_rpm:g} RPM",
        "load": known if recording.load_nm is None else f"{recording.load_nm:g} Nm",
        "angle": "none" if recording.angle is None else f"of the {recording.angle_of} shaft{zero}",
        "worn lobes": worn,
        "bad spans": ", ".join(f"{start:g} to {stop:g} s" for start, stop in recording.bad_spans) or None,
        "changes": ", ".join((recording.meta or {}).get("history", ())) or None,
        "assembly": None if recording.assembly is None else str(recording.assembly),
        "run": None if recording.run is None else str(recording.run),
        "source": source_in_words(recording.source) or None,
    }


def list_recordings(recordings: Recording | Iterable[Recording]) -> list[Recording]:
    """Return one or several recordings as a list; TypeError for anything else, ValueError for none."""
    records = (recordings,) if isinstance(recordings, Recording) else checks.list_members(recordings)
    others = [recordings] if records is None else [one for one in records if not isinstance(one, Recording)]
    if others:
        raise TypeError(f"recordings must be Recording objects, got {type(others[0]).__name__}")
    if not records:
        raise ValueError("recordings must hold at least one Recording, got none")
    return list(records)


def common_n_lobes(recordings: Sequence[Recording]) -> int:
    """Return the number of lobes of a disc that all recordings share; ``ValueError`` if they differ."""
    return int(_common_value(recordings, "n_lobes", "kind of disc", 15))


def common_quantity(recordings: Sequence[Recording]) -> str:
    """Return the quantity that all recordings share; ``ValueError`` if they differ."""
    return str(_common_value(recordings, "quantity", "quantity", QUANTITIES[0]))


def _common_value(recordings: Sequence[Recording], name: str, kind: str, default: object) -> Any:
    values = sorted({getattr(recording, name) for recording in recordings}, key=str)
    if len(values) > 1:
        got = ", ".join(map(str, values))
        raise ValueError(
            f"{name} must be the same for all recordings, got {got}: take those of one {kind} at a time"
        )
    return values[0] if values else default


def _are_equal(mine: Any, theirs: Any) -> bool:
    """Return True if two values of a field are the same, whatever objects ``meta`` holds."""
    if isinstance(mine, Mapping) and isinstance(theirs, Mapping):
        return mine.keys() == theirs.keys() and all(_are_equal(mine[key], theirs[key]) for key in mine)
    if isinstance(mine, np.ndarray) or isinstance(theirs, np.ndarray):
        return type(theirs) is type(mine) and np.array_equal(mine, theirs)
    return type(theirs) is type(mine) and bool(mine == theirs)


def _checked_samples(name: str, values: Any) -> Float:
    given = np.asarray(values)
    array = number_series(name, given, least=2)
    # What was checked must not change afterwards: a copy, except of what nobody writes to.
    if array is given and (array.flags.writeable or not array.flags.owndata):
        array = array.copy()
    if not max(-array.min(), array.max()) <= LARGEST:
        where = int(np.argmax(np.abs(array)))
        raise ValueError(f"{name} must lie within +-{LARGEST:g}, got {array[where]} at sample {where}")
    array.flags.writeable = False
    return array


def _checked_text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{name} must be text, got {value!r}")
    # Line ends would break files and tables, and NumPy drops trailing NULs, so that two names became one.
    if not value or not value.isprintable():
        raise ValueError(f"{name} must be a line of printable text, got {value!r}")
    return str(value)


def _checked_label(name: str, value: Any) -> Label | None:
    if value is None:
        return None
    if isinstance(value, str):
        return _checked_text(name, value)
    if not is_whole(value):
        raise TypeError(f"{name} must be text or a whole number, got {value!r}")
    if not -(2**63) <= value < 2**63:
        raise ValueError(f"{name} must fit into 64 bits, got {value!r}")
    return int(value)


def _checked_defects(
    worn_lobes: Any, defect_count: Any, n_lobes: int
) -> tuple[tuple[int, ...] | None, int | None]:
    count = None if defect_count is None else whole("defect_count", defect_count, 0)
    if count is not None and count > n_lobes:
        raise ValueError(f"defect_count must be at most n_lobes = {n_lobes}, got {count}")
    if worn_lobes is None:
        return () if count == 0 else None, count
    if isinstance(worn_lobes, str) or not isinstance(worn_lobes, Iterable):
        raise TypeError(f"worn_lobes must be a sequence of lobe indices from 0, got {worn_lobes!r}")
    lobes = tuple(sorted(whole("worn_lobes", lobe, 0) for lobe in worn_lobes))
    if len(set(lobes)) != len(lobes):
        raise ValueError(f"worn_lobes must be distinct, got {lobes}")
    if lobes and lobes[-1] >= n_lobes:
        raise ValueError(
            f"worn_lobes must lie between 0 and {n_lobes - 1} (n_lobes = {n_lobes}, counted from 0; "
            f"files count from 1), got {lobes}"
        )
    if count is not None and count != len(lobes):
        raise ValueError(
            f"defect_count must be the number of worn_lobes, got {count} and {len(lobes)} lobes {lobes}"
        )
    return lobes, len(lobes)
