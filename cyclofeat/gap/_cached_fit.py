"""Fits that are kept in a folder, by all that they depend on."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import joblib
from numpy.typing import NDArray

from cyclofeat.gap._fit_model import as_effects
from cyclofeat.gap._fitter import EffectFitter
from cyclofeat.gap._null import NuisancePrior, as_composite, versions


def cached_fit(
    fitter: EffectFitter,
    windows: NDArray[Any],
    data: dict[str, Any],
    cache: str | os.PathLike[str] | None,
) -> EffectFitter:
    """The fitter, fitted, or what the folder has of the same fit by the same code."""
    if cache is None:
        fitter.fit(windows, **data)
        return fitter
    memory = joblib.Memory(Path(cache) / "fits", verbose=0)
    fitted: EffectFitter = memory.cache(_fit, ignore=["fitter"])(
        fitter, _stated(fitter), versions(), windows, data
    )
    return fitted


def _fit(
    fitter: EffectFitter, stated: str, version: Any, windows: NDArray[Any], data: dict[str, Any]
) -> EffectFitter:
    """Fit; the arguments that are not used are those by which it is remembered."""
    fitter.fit(windows, **data)
    return fitter


def _stated(fitter: EffectFitter) -> str:
    """All that a fit depends on besides the data."""
    left_out = ("n_jobs", "cache", "simulator", "effect", "starts")
    rig = as_composite(fitter.simulator).to_rig().to_text()
    starts = [fitter.effect, *(fitter.starts or ())]
    effects = [[effect.to_dict() for effect in as_effects(start)] for start in starts]
    nuisance = dataclasses.asdict(fitter.nuisance or NuisancePrior())
    own = {name: value for name, value in fitter.get_params(deep=False).items() if name not in left_out}
    return repr((rig, effects, nuisance, sorted(own.items(), key=lambda item: item[0])))
