"""Errors a user can mend: what was expected, what was received, the remedy, in one line."""


class InputError(ValueError):
    """The user's input cannot be used; tools print it as one line and exit with 3.

    Parameters
    ----------
    expected, received, remedy
        Three short phrases. `str(error)` joins them into one line.
    """

    def __init__(self, *, expected: str, received: str, remedy: str):
        self.expected, self.received, self.remedy = expected, received, remedy
        super().__init__(" ".join(f"expected {expected}; received {received}; {remedy}".split()))


class MissingExtraError(ImportError):
    """An optional dependency is absent; the message names the extra that brings it."""

    def __init__(self, package: str, extra: str):
        super().__init__(f"{package} is not installed; it comes with: pip install 'sira-assets[{extra}]'")
