"""What armrig raises on purpose, as few classes as callers tell apart; all are ArmrigErrors."""


class ArmrigError(Exception):
    """Something that the user can put right; the message says what came and what to do."""


class InputError(ArmrigError, ValueError):
    """A value, or data, that cannot be used: the message says what is allowed."""


class InputTypeError(ArmrigError, TypeError):
    """An argument of a type that cannot be used: the message says what to give."""


class FileError(InputError):
    """A file that does not contain what it should: the message names the file."""


class MalformedReplyError(ArmrigError, ValueError):
    """No reply of a daemon of this version."""


class OperationError(ArmrigError, RuntimeError):
    """A program, a port or a service that is needed fails: the message says what to do."""
