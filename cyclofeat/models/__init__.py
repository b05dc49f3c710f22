"""Models on disk: a file, and beside it a card that says what it is.

=======================  =========================================================================
name                     job
=======================  =========================================================================
``save_model``           write a model or counter (``.skops`` or ``.joblib``) and its card
``load_model``           read it after checks of its card, versions and features
``load_default_model``   read the packaged model of a quantity
``default_model_path``   its path
``read_card``            read the card alone
``as_lobe_model``        make a ``LobeModel`` of what was loaded
``check_model_path``     check that a model can be written, before training
``card_path``            path of a model's card
``feature_definitions``  features that a fitted counter uses, with their versions
``estimators_in``        all estimators that a model holds
``ModelFileError``       a file that is damaged, not trusted, or does not fit its card
=======================  =========================================================================
"""

from cyclofeat.models._cache import user_cache as user_cache
from cyclofeat.models._card import card_path, feature_definitions, read_card
from cyclofeat.models._content import TRUSTED_TYPES as TRUSTED_TYPES
from cyclofeat.models._content import ModelFileError, estimators_in
from cyclofeat.models._default import default_model_path, load_default_model
from cyclofeat.models._persistence import as_lobe_model, check_model_path, load_model, save_model

__all__ = [
    "ModelFileError",
    "as_lobe_model",
    "card_path",
    "check_model_path",
    "default_model_path",
    "estimators_in",
    "feature_definitions",
    "load_default_model",
    "load_model",
    "read_card",
    "save_model",
]
