"""What is wrong inside a file, as its reader found it."""


class Damage(ValueError):
    """A phrase on what is wrong, for the error that names the file and says what to do.

    It never reaches the user by itself.
    """
