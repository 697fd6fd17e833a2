"""Materials."""


def material(prim, writer, time):
    """What a material's entry holds."""
    return {"place": str(prim.GetPath()), "name": prim.GetName()}
