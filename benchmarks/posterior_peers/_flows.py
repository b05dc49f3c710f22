"""Normalising flows of sbi and BayesFlow, run in an environment of their own: ``_flows.py NAME IN OUT``.

IN holds ``train_x``, ``train_theta`` and ``test_x``; OUT gets ``samples`` (n_test, n_samples, n_theta) and
the seconds of fit and answers.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

os.environ.setdefault("KERAS_BACKEND", "torch")

import numpy as np
import torch

_SAMPLES = 200
_EPOCHS, _BATCH = 40, 128
_COMPONENTS = 100  # of the summaries that a flow is given
_VALIDATING = 0.1

Samples = Callable[[np.ndarray], np.ndarray]


def sbi(x: np.ndarray, theta: np.ndarray) -> Samples:
    """Neural posterior estimation with a masked autoregressive flow, sbi's default."""
    from sbi.inference import NPE

    trainer = NPE(show_progress_bars=False)
    data = torch.as_tensor(theta), torch.as_tensor(x)
    trainer.append_simulations(*data).train(training_batch_size=_BATCH, validation_fraction=_VALIDATING)
    posterior = trainer.build_posterior()

    def of_some(given: np.ndarray) -> np.ndarray:
        drawn = posterior.sample_batched(
            (_SAMPLES,), x=torch.as_tensor(given), show_progress_bars=False, reject_outside_prior=False
        )
        return np.swapaxes(drawn.detach().numpy(), 0, 1)

    def samples(given: np.ndarray) -> np.ndarray:
        # All at once take tens of gigabytes.
        return np.concatenate([of_some(given[first : first + 25]) for first in range(0, len(given), 25)])

    return samples


def bayesflow(x: np.ndarray, theta: np.ndarray) -> Samples:
    """Amortised estimation with a coupling flow, BayesFlow's default."""
    import bayesflow as bf
    import keras

    keras.utils.set_random_seed(0)

    adapter = (
        bf.Adapter()
        .convert_dtype("float64", "float32")
        .rename("theta", "inference_variables")
        .rename("x", "inference_conditions")
    )
    workflow = bf.BasicWorkflow(
        adapter=adapter, inference_network=bf.networks.CouplingFlow(), standardize="inference_variables"
    )
    n = round(len(x) * _VALIDATING)
    parts = [{"theta": theta[rows], "x": x[rows]} for rows in (slice(n, None), slice(n))]
    workflow.fit_offline(parts[0], epochs=_EPOCHS, batch_size=_BATCH, validation_data=parts[1], verbose=0)
    return lambda given: workflow.sample(conditions={"x": given}, num_samples=_SAMPLES)["theta"]


def main(name: str, source: str, target: str) -> None:
    """Train one method and write samples of its posteriors."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    with np.load(source) as file:
        train_x, theta, test_x = (
            file[key].astype(np.float32) for key in ("train_x", "train_theta", "test_x")
        )
    centre, spread = train_x.mean(axis=0), train_x.std(axis=0) + 1e-3
    train_x, test_x = ((x - centre) / spread for x in (train_x, test_x))
    # Flows that take all summaries learn the rigs by heart.
    _, _, axes = np.linalg.svd(train_x, full_matrices=False)
    axes = axes[:_COMPONENTS].T
    scale = (train_x @ axes).std(axis=0)
    train_x, test_x = (np.clip(x @ axes / scale, -5, 5).astype(np.float32) for x in (train_x, test_x))
    began = time.perf_counter()
    samples = {"sbi": sbi, "bayesflow": bayesflow}[name](train_x, theta)
    fitted = time.perf_counter()
    found = np.asarray(samples(test_x), dtype=np.float32)
    answered = time.perf_counter()
    np.savez(target, samples=found, fit=fitted - began, answer=answered - fitted)


if __name__ == "__main__":
    main(*sys.argv[1:])
