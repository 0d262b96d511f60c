"""The exceptions that armrig raises: one class for each case that callers distinguish."""


class ArmrigError(Exception):
    """An error that the user can correct; the message says what is wrong and what to do.

    Examples
    --------
    >>> import armrig
    >>> try:
    ...     armrig.oe(armrig.example_recording().dataset("alpha"), nb=3)
    ... except armrig.ArmrigError as err:
    ...     print(err)
    oe needs nf: oe(data, nb=…, nf=…)
    """


class InputError(ArmrigError, ValueError):
    """A value or data that cannot be used; the message says what is allowed.

    Examples
    --------
    >>> import armrig
    >>> try:
    ...     u = armrig.step(500, high=6)
    ... except armrig.InputError as err:
    ...     print(err)
    high=6 V is outside the rig's 0 to 5 V
    """


class ParameterError(InputError):
    """A forbidden value of a parameter whose name differs between Python and the command line.

    Parameters
    ----------
    parameter : str
        Name in Python, such as "dead_man".
    value : str
        The value as text, with or without its unit.
    reason : str
        Text after the name and the value in the message: the allowed values.

    Examples
    --------
    >>> str(ParameterError("at", "9 s", "must be less than 3 s"))
    'at 9 s: must be less than 3 s'
    >>> ParameterError("at", "9 s", "must be less than 3 s").named("--at")
    '--at 9 s: must be less than 3 s'
    """

    def __init__(self, parameter: str, value: str, reason: str) -> None:
        super().__init__(parameter, value, reason)
        self.parameter = parameter
        self._text = f"{value}: {reason}"

    def named(self, name: str) -> str:
        """Return the message with `name` as the name of the parameter."""
        return f"{name} {self._text}"

    def __str__(self) -> str:
        """Return the message with the parameter's name in Python."""
        return self.named(self.parameter)


class InputTypeError(ArmrigError, TypeError):
    """An argument of a wrong type; the message says which type to give."""


class FileError(InputError):
    """A file with unusable content; the message names the file.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> np.savetxt("table.csv", [[0, 1, 2]], delimiter=",", header="t,u,y", comments="")
    >>> try:
    ...     recording = armrig.load("table.csv")
    ... except armrig.FileError as err:
    ...     print(err)
    table.csv: is not a recording of the rig; give a recording ...
    """


class MalformedReplyError(ArmrigError, ValueError):
    """A reply that a daemon of this version does not send."""


class OperationError(ArmrigError, RuntimeError):
    """A failure of a program, a port or a service; the message says what to do."""
