"""Models on disk: a file, and beside it a card that says what it is.

======================  =========================================================================
name                    job
======================  =========================================================================
``save_model``          write a model or counter (``.skops`` or ``.joblib``) and its card
``load_model``          read it after checks of its card, versions and features
``load_default_model``  read the packaged model of a quantity
``ModelFileError``      a file that is damaged, not trusted, or does not fit its card
======================  =========================================================================

``persistence`` checks, writes and reads files, ``content`` what they hold, ``card`` the cards.
"""

from cyclofeat.models.content import ModelFileError
from cyclofeat.models.persistence import load_default_model, load_model, save_model

__all__ = ["ModelFileError", "load_default_model", "load_model", "save_model"]
