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

    def __reduce__(self):
        # Exceptions are pickled by their positional arguments; a worker process must be able to hand this one back.
        return _input_error, (self.expected, self.received, self.remedy)


def _input_error(expected: str, received: str, remedy: str) -> InputError:
    return InputError(expected=expected, received=received, remedy=remedy)


class MissingExtraError(ImportError):
    """An optional dependency is absent; the message names the extra that brings it."""

    def __init__(self, package: str, extra: str):
        self.package, self.extra = package, extra
        super().__init__(f"{package} is not installed; it comes with: pip install 'sira-assets[{extra}]'")

    def __reduce__(self):
        return MissingExtraError, (self.package, self.extra)
