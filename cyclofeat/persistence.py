"""Models on disk.

A joblib file is a pickle: loading it runs code from the file. It is loaded only where the caller says that
the file is trusted.
"""

from __future__ import annotations

import os
from pathlib import Path

import joblib

from cyclofeat._files import write_whole
from cyclofeat.counting import LobeModel


class ModelFileError(ValueError):
    """A model file that cannot be read, is not trusted or holds something else."""


def save_model(path: str | os.PathLike[str], model: LobeModel) -> Path:
    """Write a model with joblib; the file appears whole or not at all.

    Parameters
    ----------
    path : path-like
        File to write, usually ``*.joblib``.
    model : LobeModel

    Returns
    -------
    pathlib.Path

    Raises
    ------
    TypeError
        For anything but a LobeModel.
    FileNotFoundError
        Where the folder does not exist.
    """
    if not isinstance(model, LobeModel):
        raise TypeError(f"model must be a LobeModel, got {type(model).__name__}")
    return write_whole(Path(path), lambda file: joblib.dump(model, file, compress=3))


def load_model(path: str | os.PathLike[str], *, trusted: bool = False) -> LobeModel:
    """Read a model that :func:`save_model` wrote.

    Parameters
    ----------
    path : path-like
        File to read.
    trusted : bool
        Whether the file comes from a trusted source. A joblib file can run any code when loaded.

    Returns
    -------
    LobeModel

    Raises
    ------
    FileNotFoundError
        Where there is no such file.
    ModelFileError
        Where the file is not trusted, is damaged or holds something else.
    """
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"model file {source} does not exist")
    if not trusted:
        raise ModelFileError(
            f"{source} is a joblib file, which can run any code when loaded: if you trust where it comes "
            "from, load it with trusted=True (--trust-model on the command line)"
        )
    try:
        model = joblib.load(source)
    except Exception as error:
        raise ModelFileError(
            f"{source} cannot be read as a joblib model ({type(error).__name__}: {error}): it is damaged or "
            "was written by other versions"
        ) from error
    if not isinstance(model, LobeModel):
        raise ModelFileError(f"{source} holds a {type(model).__name__}, not a cyclofeat LobeModel")
    return model
