"""Runs on many machines, by dask.distributed.

    import lumistack.farm

    lumistack.farm.run("job.toml", "runs/shot", workers=4)      # processes of this machine
    tls = ("ca.pem", "me.pem", "me-key.pem")
    lumistack.farm.run("job.toml", "/mnt/shots/one", address="tls://head:8786", tls=tls)

A run is split into units of work. A worker executes a unit by the command `lumistack farm unit`.
Workers exchange data through the run folder, which they share. Dask transfers only the id of a unit
and a line of JSON about its result. `pip install 'lumistack[farm]'` installs Dask.
"""

from lumistack.farm._engine import FarmError, Outcome, Unit, execute, plan, run

__all__ = ["FarmError", "Outcome", "Unit", "execute", "plan", "run"]
