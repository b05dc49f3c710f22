"""Effects in the gearbox: nominal values, geometry, contact, and the brake behind it."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator
from scipy.stats import loguniform, norm

from cyclofeat._base.checks import list_members, one_of, repr_of
from cyclofeat.simulators.effects.effect import Effect, EffectParameter, Of, suggest_key
from cyclofeat.simulators.gearbox import CycloidalGearbox

_FORMS = ("paper", "hunt_crossley")
# Fields of the gearbox that are plain numbers, and may be set or explored one by one.
GEARBOX_NUMBERS = tuple(
    field.name for field in dataclasses.fields(CycloidalGearbox) if isinstance(field.default, float)
)


class PinErrors(Effect):
    """Position errors of the pins: each external sleeve sits off its place.

    Pin j moves by independent normal errors (dr_j, dt_j) of standard deviation ``rms``, radially and
    tangentially, in addition to those of the gearbox. The torque's pattern then repeats after a whole
    output turn only, and lines appear between those of the lobes. The pattern stays with the housing and
    changes with it, where lobe wear stays with the disc.
    """

    parameters: ClassVar = {
        "rms": EffectParameter("m", 0.0, 2e-4, 0.0, loguniform(2e-6, 5e-5), log=True, default=10e-6)
    }
    separated_by = "several assemblies of one disc"

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        errors = self.rms * random.normal(size=(2, gearbox.n_pins))
        if self.rms == 0:
            return gearbox
        return gearbox.replace(
            pin_radial_errors=errors[0] + (gearbox.pin_radial_errors or 0.0),
            pin_tangential_errors=errors[1] + (gearbox.pin_tangential_errors or 0.0),
        )


class LobePitchErrors(Effect):
    """Pitch errors of the lobes: each sits off its place along the pitch circle.

    Lobe l of either wheel moves by an independent normal error of standard deviation ``rms`` at the circle of
    the pins, on top of what the gearbox already has. The pattern stays with the disc, like wear, but is
    spread over all lobes.
    """

    parameters: ClassVar = {
        "rms": EffectParameter("m", 0.0, 2e-4, 0.0, loguniform(1e-6, 5e-5), log=True, default=5e-6)
    }
    separated_by = "several discs in one housing"

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        errors = self.rms * random.normal(size=2 * gearbox.n_lobes)
        if self.rms == 0:
            return gearbox
        return gearbox.replace(lobe_pitch_errors=errors + (gearbox.lobe_pitch_errors or 0.0))


class RunOut(Effect):
    """Run-out of the wheels: each profile sits off its bearing by a constant offset.

    The profile of wheel k is moved by ``runout`` exp(i a_k) in the wheel's frame, with a random direction
    a_k, in addition to those of the gearbox. The offset turns with the wheel, once per output turn against
    the housing and 16/15 times per input turn (8.889 Hz at 500 RPM, z_k = 16) against the load. Run-out is
    one smooth wave over the 15 lobes, a worn lobe a short event at one of them.

    Parameters
    ----------
    wheels : tuple of int, default (0, 1)
        Wheels that run out. Two effects, one for each wheel, have separate lengths; ``rayleigh(scale=s)``
        is the length of an offset whose components are normal with standard deviation s.
    """

    parameters: ClassVar = {
        "runout": EffectParameter("m", 0.0, 2e-4, 0.0, loguniform(2e-6, 1e-4), log=True, default=10e-6)
    }
    settings: ClassVar = {"wheels": (0, 1)}
    separated_by = "the folded torque over whole output turns"

    def check_settings(self) -> None:
        given = list_members(self.wheels)
        if given is None or given not in ((0,), (1,), (0, 1)):
            raise ValueError(f"wheels of {self.effect_id} must be (0,), (1,) or (0, 1), got {self.wheels!r}")

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        directions = np.exp(2j * np.pi * random.random(2))
        if self.runout == 0:
            return gearbox
        offsets = np.array(gearbox.wheel_runouts or (0j, 0j))
        for wheel in map(int, self.wheels):
            offsets[wheel] += self.runout * directions[wheel]
        return gearbox.replace(wheel_runouts=offsets)


class CamRunOut(Effect):
    """Run-out of the cams: each cam's centre sits off its ideal place on the input shaft.

    The centre of cam k is moved by ``runout`` exp(i a_k) in the frame of the input shaft, with a random
    direction a_k, in addition to those of the gearbox. With unequal pins this shows once per input turn
    (1x, 8.333 Hz at 500 RPM), near the worn lobes' 16/15, from which a whole output turn resolves it; with
    equal pins it changes the mesh lines alone.
    """

    parameters: ClassVar = {
        "runout": EffectParameter("m", 0.0, 2e-4, 0.0, loguniform(2e-6, 1e-4), log=True, default=10e-6)
    }
    separated_by = "at least one whole output turn"

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        directions = np.exp(2j * np.pi * random.random(2))
        if self.runout == 0:
            return gearbox
        offsets = np.asarray(gearbox.cam_errors or (0j, 0j))
        return gearbox.replace(cam_errors=offsets + self.runout * directions)


class Clearance(Effect):
    """Clearance (backlash) of the internal sleeves in the holes of the wheels.

    The holes' radius, and with it the gap r_h - r_s - e of a centred sleeve, grows by ``clearance``. It is
    the dead zone of the torque-deflection loop; stiffness of the contacts changes the loop's slope instead.
    """

    parameters: ClassVar = {
        "clearance": EffectParameter("m", 0.0, 1e-3, 0.0, loguniform(2e-6, 2e-4), log=True, default=20e-6)
    }
    separated_by = "the torque-deflection loop with held output"

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        return gearbox.replace(clearance=gearbox.clearance + self.clearance)


class Scale(Effect):
    """One quantity of the rig by a factor: stiffness or damping of all contacts, set-point of load or speed.

    The stiffness is the K of paper B eq. 14 and the damping the C of eq. 11, for external and internal
    sleeves; load and speed are the means of brake and input. A search proposes neither load, as the gain of
    the torque meter looks the same, nor speed, as recordings are compared at their own. Damping shortens the
    ringing, which a low-pass in the torque meter does not.

    Parameters
    ----------
    of : {"contact_stiffness", "contact_damping", "load", "speed"}
        The quantity. In files the effect is named ``contact_stiffness_scale``, ``contact_damping_scale``,
        ``load_scale`` or ``speed_scale``.
    factor : float or (low, high)
        A pure number; 1 is neutral.
    """

    effect_id: ClassVar[Any] = Of(
        contact_stiffness="contact_stiffness_scale", contact_damping="contact_damping_scale",
        load="load_scale", speed="speed_scale",
    )  # fmt: skip
    summary: ClassVar[Any] = Of(
        contact_stiffness="Stiffness of all contacts, by a factor on paper B's coefficient H.",
        contact_damping="Damping of all contacts, by a factor on C.",
        load="Load of the brake by a factor: its set-point is off, or differs between assemblies.",
        speed="Speed of the input by a factor: its set-point is off, or differs between assemblies.",
    )
    place: ClassVar[Any] = Of(
        contact_stiffness="contact", contact_damping="contact", load="load_and_speed", speed="load_and_speed"
    )
    parameters: ClassVar[Any] = Of(
        contact_stiffness={"factor": EffectParameter("1", 1e-3, 1e3, 1.0, loguniform(0.25, 4.0), log=True)},
        contact_damping={"factor": EffectParameter("1", 0.0, 1e3, 1.0, loguniform(0.25, 4.0), log=True)},
        # 0.5 Nm on the papers' 22 Nm.
        load={"factor": EffectParameter("1", 0.0, 1e3, 1.0, norm(1.0, 0.5 / 22))},
        speed={"factor": EffectParameter("1", 1e-3, 1e3, 1.0, norm(1.0, 0.01))},
    )
    separated_by: ClassVar[Any] = Of(
        contact_stiffness="two loads, or the slope of the torque-deflection loop with held output",
        contact_damping="a tap test with the machine at rest",
        load="a dead-weight calibration, and the brake's own reading",
        speed="a tachometer",
    )
    shows_as: ClassVar[Any] = Of(
        contact_stiffness="", contact_damping="", load="mean torque", speed="time axis"
    )
    proposed: ClassVar[Any] = Of(contact_stiffness=True, contact_damping=True, load=False, speed=False)

    def __init__(self, of: str, factor: Any) -> None:
        self.of = of
        self.factor = factor

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        field = {
            "contact_stiffness": "stiffness_scale", "contact_damping": "contact_damping",
            "load": "load_torque", "speed": "input_speed",
        }[self.of]  # fmt: skip
        return gearbox.replace(**{field: getattr(gearbox, field) * self.factor})


class ContactDampingForm(Effect):
    """Form of the contact damping: C d' as in the papers, or weighted with the elastic force.

    The contact force becomes F = F_e (1 + D d') (Hunt and Crossley 1975) instead of F_e + C d'. The
    damping is matched so that small torsional vibration about the mean load loses the same energy in the
    ring of pins: sum C a_j^2 = sum D F_j a_j^2, hence D = C sum a_j^2 / sum F_j a_j^2 over the loaded half
    of the pins, with the lever arms a_j = e z_s sin(pi (j + 1/2) / (z_k // 2)) and the Hertzian shares
    F_j = (T/2) a_j^1.5 / sum a_j^2.5 of the mean load T (which do not depend on K). The match holds neither
    for the internal sleeves nor in impacts, where the forms differ; the weighted damping grows with the load.

    Parameters
    ----------
    form : {"hunt_crossley", "paper"}, default "hunt_crossley"
        Form after the effect. The form of the gearbox is neutral.
    factor : float or (low, high), default 1
        Factor on the matched damping, a pure number.
    """

    place = "contact"
    parameters: ClassVar = {"factor": EffectParameter("1", 1e-3, 1e3, 1.0, loguniform(0.5, 2.0), log=True)}
    separated_by = "recordings at two loads"

    def __init__(self, form: str = "hunt_crossley", factor: Any = 1.0) -> None:
        self.form = form
        self.factor = factor

    def check_settings(self) -> None:
        one_of(f"form of {self.effect_id}", self.form, _FORMS)

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        if gearbox.contact_law not in _FORMS:
            raise ValueError(f"{self.effect_id} needs a contact_law in {_FORMS}, got {gearbox.contact_law!r}")
        damping = gearbox.contact_damping
        if self.form != gearbox.contact_law:
            if gearbox.load_torque <= 0:
                raise ValueError(f"{self.effect_id} needs a load_torque above 0, got {gearbox.load_torque!r}")
            # D/C in 1/N of the two forms of contact damping, matched in the ring of pins at mean load.
            loaded = max(gearbox.n_pins // 2, 1)
            arms = gearbox.eccentricity * gearbox.n_lobes * np.sin(np.pi * (np.arange(loaded) + 0.5) / loaded)
            forces = gearbox.load_torque / 2 * arms**1.5 / np.sum(arms**2.5)
            per_force = float(np.sum(arms**2) / np.sum(forces * arms**2))
            damping = damping * per_force if self.form == "hunt_crossley" else damping / per_force
        return gearbox.replace(contact_law=self.form, contact_damping=damping * self.factor)


class SleeveFriction(Effect):
    """Friction of the sleeves on the wheels and on their axles: Coulomb, Stribeck and viscous.

    A sleeve pressed with N that slides at s rubs with N (mu + (mu_0 - mu) exp(-(s/s_0)^2)) tanh(s/s_t) + c s,
    with mu = ``coulomb``, mu_0 - mu = ``stribeck`` and c = ``viscous``; its axle holds it back with
    ``journal`` N (coefficient times the ratio of axle to sleeve radius). The sleeves then spin on their
    axles. All add to the friction of the gearbox; the effect is neutral if all are 0. Coulomb friction keeps
    its size and turns with the direction, viscous friction grows with the speed, an offset does neither.
    """

    place = "joints"
    parameters: ClassVar = {
        "coulomb": EffectParameter("1", 0.0, 1.0, 0.0, loguniform(0.005, 0.2), log=True, default=0.05),
        "stribeck": EffectParameter("1", 0.0, 1.0, 0.0),
        "viscous": EffectParameter("Ns/m", 0.0, 1e3, 0.0),
        "journal": EffectParameter("1", 0.0, 1.0, 0.0),
    }
    separated_by = "two speeds and both directions"
    moves_mean = True

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        if self.coulomb == self.stribeck == self.viscous == self.journal == 0:
            return gearbox
        at_rest = gearbox.sleeve_static_friction or gearbox.sleeve_friction
        return gearbox.replace(
            sleeve_friction=gearbox.sleeve_friction + self.coulomb,
            sleeve_static_friction=at_rest + self.coulomb + self.stribeck,
            sleeve_viscous_friction=gearbox.sleeve_viscous_friction + self.viscous,
            journal_friction=gearbox.journal_friction + self.journal,
        )


class BearingFriction(Effect):
    """Friction of the output shaft's bearings, between the gearbox and the torque meter.

    The bearings oppose the output with ``coulomb`` tanh(w/w_t) + ``viscous`` w, in addition to the friction
    of the gearbox. As the load acts behind them, they load the gearbox, not the meter.
    """

    place = "joints"
    parameters: ClassVar = {
        "coulomb": EffectParameter("Nm", 0.0, 100.0, 0.0, loguniform(0.02, 2.0), log=True, default=0.2),
        "viscous": EffectParameter("Nms/rad", 0.0, 100.0, 0.0),
    }
    separated_by = "two speeds and both directions"

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        return gearbox.replace(
            output_bearing_torque=gearbox.output_bearing_torque + self.coulomb,
            output_bearing_viscosity=gearbox.output_bearing_viscosity + self.viscous,
        )


class BrakeRotor(Effect):
    """Rotor of the brake behind the compliance of shaft and torque meter.

    J w' = k (psi - psi_b) + c (psi' - w) - T_load with the ``inertia`` J, the torsional ``stiffness`` k of
    shaft and meter, and c = 2 ``damping_ratio`` sqrt(k J); the torque is that in the meter, k (psi - psi_b) +
    c (psi' - w) (:meth:`cyclofeat.simulators.CycloidalGearbox.with_brake`). Without inertia the output is
    free. The gearbox must not have a brake already. The resonance stays at its frequency in Hz where lobe
    lines move with the speed, and it rings on after a blow, which a low-pass in the meter does not.
    """

    place = "shaft_and_meter"
    parameters: ClassVar = {
        "inertia": EffectParameter("kg m2", 0.0, 10.0, 0.0, loguniform(2e-3, 0.1), log=True, default=0.02),
        "stiffness": EffectParameter("Nm/rad", 1.0, 1e7, None, loguniform(1e3, 3e4), log=True, default=1e4),
        "damping_ratio": EffectParameter("1", 0.0, 0.99, None, loguniform(5e-3, 0.1), log=True, default=0.02),
    }
    separated_by = "a tap test on the rotor, or two speeds"

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        if self.inertia == 0:
            return gearbox
        if (brake := gearbox.brake_inertia) > 0:
            raise ValueError(f"{self.effect_id} needs a gearbox without a brake, got brake_inertia {brake:g}")
        return gearbox.with_brake(self.inertia, self.stiffness, self.damping_ratio)


class GearboxParameter(Effect):
    """A parameter of the nominal gearbox: sets one of its fields before anything else acts.

    With a range or a distribution, assemblies differ in this field.

    Parameters
    ----------
    parameter : str
        Name of a numeric field of :class:`cyclofeat.simulators.CycloidalGearbox`.
    value : float or (low, high), default 22
        Value of the field, in its SI unit.

    Examples
    --------
    >>> from cyclofeat.simulators import Rig
    >>> rig = Rig(effects=[GearboxParameter("load_torque", (15.0, 25.0))])
    >>> 15 <= rig.draw(0).gearbox.load_torque <= 25
    True
    """

    place = "nominal"
    parameters: ClassVar = {"value": EffectParameter("1", -1e15, 1e15)}
    separated_by = "a drawing of the gearbox"
    proposed = False

    def __init__(self, parameter: str = "load_torque", value: Any = 22.0) -> None:
        self.parameter = parameter
        self.value = value

    def check_settings(self) -> None:
        if not isinstance(self.parameter, str) or self.parameter not in GEARBOX_NUMBERS:
            raise ValueError(
                f"parameter of {self.effect_id} must be a numeric field of the gearbox, got "
                f"{repr_of(self.parameter)}: {suggest_key(str(self.parameter), GEARBOX_NUMBERS)}"
            )

    def change_gearbox(self, gearbox: CycloidalGearbox, random: Generator) -> CycloidalGearbox:
        return gearbox.replace(**{self.parameter: self.value})
