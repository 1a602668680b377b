"""What is wrong inside a file, as its reader found it."""


class Damage(ValueError):
    """A phrase saying what is wrong, for the error that names the file.

    It never reaches the user by itself.
    """
