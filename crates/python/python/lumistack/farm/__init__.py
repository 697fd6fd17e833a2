"""Runs on many machines, by dask.distributed.

    import lumistack.farm

    lumistack.farm.run("job.toml", "runs/shot", workers=4)      # processes of this machine
    tls = ("ca.pem", "me.pem", "me-key.pem")
    lumistack.farm.run("job.toml", "/mnt/shots/one", address="tls://head:8786", tls=tls)

A run is split into units of work; each is a call of the command `lumistack farm unit`. Data is
passed through the run folder, which all workers share. Dask transfers only ids of units and a line
of JSON about each. `pip install 'lumistack[farm]'` installs Dask.
"""

from lumistack.farm._engine import FarmError, Outcome, Unit, execute, plan, run

__all__ = ["FarmError", "Outcome", "Unit", "execute", "plan", "run"]
