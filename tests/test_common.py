"""scikit-learn's own conformance checks over every estimator.

``estimators()`` lists the instances, ``EXPECTED_FAILURES`` what may fail and why. No estimator may set a tag
to get around a check. The first instance of a class passes every check; the others pass those that fit and
look at results (``FOR_VARIANTS``), since validation and tags do not depend on their parameters.
"""

from functools import cache
from typing import Any

import pytest
from sklearn.base import BaseEstimator, clone
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline
from sklearn.utils import estimator_checks, get_tags
from sklearn.utils.estimator_checks import parametrize_with_checks
from transformers import RATE, SPECTRAL, STATISTICS, WAVELET

from cyclofeat.counting import (
    EntropyLadder,
    GroupCalibratedCounter,
    LobeCounter,
    TrainingDomain,
    make_lobe_counter,
)
from cyclofeat.counting.calibration.conformal_regressor import ConformalRegressor
from cyclofeat.features import LobeMap


@cache
def estimators() -> list[BaseEstimator]:
    """Every public estimator, and once more with the parameters that change its way through the code."""
    return [
        *STATISTICS,
        *SPECTRAL,
        *WAVELET,
        LobeMap(RATE),
        LobeMap(RATE, align="start", speed_tolerance=0, ar_order=0),
        make_lobe_counter(RATE, n_trees=4),
        make_lobe_counter(RATE, kind="entropy", n_trees=4),
        make_lobe_counter(RATE, kind="ladder"),
        EntropyLadder(),
        EntropyLadder(column=-1),
        LobeCounter(RATE, n_lobes=4, n_trees=2, n_splits=2),
        LobeCounter(RATE, kind="network", n_lobes=4, n_epochs=1, n_splits=2),
        GroupCalibratedCounter(LogisticRegression(), n_splits=2),
        ConformalRegressor(n_trees=2, n_splits=2),
        TrainingDomain(n_splits=2),
    ]


_STEPS_ARE_FITTED = "Pipeline.fit fits the steps that it was given: every plain scikit-learn Pipeline fails"
#: Of pipelines: check -> reason. No other estimator fails any.
EXPECTED_FAILURES = {
    "check_estimators_overwrite_params": _STEPS_ARE_FITTED,
    "check_dont_overwrite_parameters": _STEPS_ARE_FITTED,
}


def expected_failures(estimator: BaseEstimator) -> dict[str, str]:
    return EXPECTED_FAILURES if isinstance(estimator, Pipeline) else {}


# Checks that scikit-learn runs on its own estimators but never yields to those of others.
FOR_ALL = ("check_param_validation", "check_dataframe_column_names_consistency")
FOR_TRANSFORMERS = (
    "check_transformer_get_feature_names_out",
    "check_transformer_get_feature_names_out_pandas",
    "check_set_output_transform",
    "check_set_output_transform_pandas",
    "check_set_output_transform_polars",
    "check_global_output_transform_pandas",
    "check_global_set_output_transform_polars",
)


FOR_VARIANTS = {
    "check_classifiers_train",
    "check_estimators_dtypes",
    "check_estimators_nan_inf",
    "check_estimators_pickle",
    "check_fit2d_1feature",
    "check_fit2d_1sample",
    "check_fit_idempotent",
    "check_methods_subset_invariance",
    "check_set_output_transform",
    "check_transformer_general",
    "check_transformer_get_feature_names_out",
}


#: Estimators that pass every check in the quick tests: a transformer, a classifier, a regressor, a detector.
#: The others are built like them: their remaining checks are slow tests.
IN_FULL = {"TorqueStatistics", "EntropyLadder", "ConformalRegressor", "TrainingDomain"}


def name_of(estimator: BaseEstimator) -> str:
    """Class of an estimator; a pipeline goes by its steps."""
    steps = [type(step).__name__ for _, step in getattr(estimator, "steps", [])]
    return " ".join([type(estimator).__name__, *steps])


def marks(estimator: BaseEstimator, check: str) -> list[pytest.MarkDecorator]:
    """What the quick tests leave to the slow ones."""
    first = in_words(estimator) not in variants()
    return [] if first and (name_of(estimator) in IN_FULL or check in FOR_VARIANTS) else [pytest.mark.slow]


@cache
def in_words(estimator: BaseEstimator) -> str:
    """Estimator with its parameters, which is slow to write and asked for at each of its checks."""
    return str(estimator)


@cache
def variants() -> set[str]:
    """Estimators in words that are not the first of their class."""
    names = [name_of(estimator) for estimator in estimators()]
    return {in_words(one) for k, one in enumerate(estimators()) if names[k] in names[:k]}


def yielded_checks() -> pytest.MarkDecorator:
    decorator = parametrize_with_checks(estimators(), expected_failed_checks=expected_failures)
    names, checks = decorator.mark.args
    others = variants()
    assert others
    # A list, since scikit-learn 1.6 hands over a generator, which pytest 9.1 warns of while collecting:
    # too early for a filter in this file.
    chosen = [
        pytest.param(
            estimator,
            check,
            id="-".join([in_words(estimator), check.func.__name__, *map(str, check.keywords.values())]),
            marks=[*getattr(case, "marks", ()), *marks(estimator, check.func.__name__)],
        )
        for case in checks
        for estimator, check in [getattr(case, "values", case)]
        # Of variants, only checks with data as they are, not with memory maps that cannot be written.
        if in_words(estimator) not in others
        or (check.func.__name__ in FOR_VARIANTS and not check.keywords.get("readonly_memmap"))
    ]
    return pytest.mark.parametrize(names, chosen)


def checks_by_name() -> list[Any]:
    params = []
    others = variants()
    for estimator in estimators():
        for name in FOR_ALL + (FOR_TRANSFORMERS if hasattr(estimator, "transform") else ()):
            if in_words(estimator) in others and name not in FOR_VARIANTS:
                continue
            label = f"{in_words(estimator)}-{name}"
            params.append(pytest.param(estimator, name, id=label, marks=marks(estimator, name)))
    return params


# A tree's share of a class may be 0.
@pytest.mark.filterwarnings("ignore:divide by zero encountered in log:RuntimeWarning:sklearn.ensemble")
@yielded_checks()
def test_yielded_checks(estimator, check):
    check(estimator)


# The checks of set_output fit on a data frame and transform an array, and the other way round, on purpose.
@pytest.mark.filterwarnings("ignore:X does not have valid feature names, but:UserWarning")
@pytest.mark.filterwarnings("ignore:X has feature names, but:UserWarning")
@pytest.mark.parametrize(("estimator", "name"), checks_by_name())
def test_checks_that_are_never_yielded(estimator, name):
    getattr(estimator_checks, name)(type(estimator).__name__, clone(estimator))


@pytest.mark.parametrize("estimator", estimators(), ids=in_words)
def test_no_tag_gets_around_a_check(estimator):
    tags = get_tags(estimator)
    assert tags.requires_fit
    given = tags.input_tags
    assert given.two_d_array
    around = (tags.no_validation, tags.non_deterministic, tags._skip_test)
    assert not any((*around, given.three_d_array, given.allow_nan, given.positive_only))
    if tags.transformer_tags is not None:
        assert tags.transformer_tags.preserves_dtype == ["float64"]
