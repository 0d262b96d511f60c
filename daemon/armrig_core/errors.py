"""What armrig raises on purpose: every such error is an ArmrigError, and no other one is."""


class ArmrigError(Exception):
    """Something that the user can put right; the message says what came and what to do."""


class InputError(ArmrigError, ValueError):
    """A value, or data, that cannot be used: the message says what is allowed."""


class InputTypeError(ArmrigError, TypeError):
    """An argument of a type that cannot be used: the message says what to give."""
