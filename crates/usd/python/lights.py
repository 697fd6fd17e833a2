"""Lights."""


def light(prim, writer, time):
    """The entry of a light, or None where the prim is none."""
    return None
