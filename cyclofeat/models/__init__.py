"""Models on disk: a file, and beside it a card that says what it is.

``persistence`` checks, writes and reads files, ``content`` what they hold, ``card`` the cards.
"""

from cyclofeat.models.content import ModelFileError
from cyclofeat.models.persistence import load_default_model, load_model, save_model

__all__ = ["ModelFileError", "load_default_model", "load_model", "save_model"]
