"""Runs on many machines, by dask.distributed.

    import lumistack.farm

    lumistack.farm.run("job.toml", "runs/shot", workers=4)                          # processes of this machine
    lumistack.farm.run("job.toml", "/mnt/shots/one", address="tls://head:8786", tls=("ca.pem", "me.pem", "me-key.pem"))

A run is cut into units of work, each a call of the command `lumistack farm unit`. Data goes through the run folder, which all workers share; through Dask go ids of units and a
line of JSON about each. `pip install 'lumistack[farm]'` brings Dask along.
"""

from lumistack.farm._engine import FarmError, Outcome, Unit, execute, plan, run

__all__ = ["FarmError", "Outcome", "Unit", "execute", "plan", "run"]
