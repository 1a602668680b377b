"""What is known of a model of an open set before its mesh is made."""

from typing import NamedTuple


class OpenModel(NamedTuple):
    """One model of a package.

    name: unique in its category. family: models of one family are variants of one
    design. side: "train", or "test" where reserved for testing. origin: what goes into
    the file beside the model. package: that it comes in. source: what the package's
    module needs to make it.
    """

    name: str
    family: str
    side: str
    origin: dict
    package: str
    source: tuple
