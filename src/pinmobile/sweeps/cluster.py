"""A Dask cluster: the client of its scheduler, and whether it is still there."""

from concurrent.futures import ThreadPoolExecutor
from time import monotonic
from typing import Any

from pinmobile.errors import InvalidArgument, SchedulerError, shown
from pinmobile.sweeps.extras import imported

__all__ = ["GO_ON", "Watch", "check_client", "connected"]

GO_ON = "what is done is in the store: start the same sweep again to go on"
"""What to do when a cluster is lost."""

_ANSWER = 10.0  # seconds that a scheduler has to answer, and to have a worker
_ALONE = 60.0  # seconds that a cluster may be without a worker: a dead one is often started again


def check_client(client: Any) -> None:
    """Refuse what is no client, or is not connected.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    kind = imported("distributed").Client
    if not isinstance(client, kind):
        raise InvalidArgument(f"client is a {type(client).__name__}, expected a distributed.Client")
    if client.status != "running" or client.asynchronous:
        state = client.status if client.status != "running" else "asynchronous"
        raise InvalidArgument(f"client is {state}, expected one that is connected to its scheduler")


def connected(address: str, timeout: float = _ANSWER) -> Any:
    """Return a `distributed.Client` of the scheduler at an address.

    Parameters
    ----------
    address : str
        Such as ``tcp://127.0.0.1:8786``.
    timeout : float
        Time that it has to answer [s].

    Raises
    ------
    SchedulerError
        If it does not, or what answers is something else.
    InvalidArgument
        If it is no address.
    """
    import asyncio  # here, because most sweeps have no cluster

    distributed = imported("distributed")
    try:
        distributed.comm.resolve_address(address)
    except OSError:
        pass  # an unknown host, of which the connection tells
    except (ValueError, TypeError) as error:
        raise InvalidArgument(
            f"scheduler is {shown(address)}, expected an address such as tcp://127.0.0.1:8786"
        ) from error
    try:
        with ThreadPoolExecutor(1) as pool:  # a notebook's thread has a loop of its own
            kind = pool.submit(asyncio.run, asyncio.wait_for(_kind(address, timeout), timeout)).result()
        if kind == "Scheduler":
            return distributed.Client(address, timeout=timeout)
    except (OSError, TimeoutError) as error:
        raise SchedulerError(f"scheduler {address} does not answer within {timeout:g} s") from error
    except Exception as error:  # what it says is read as a length, a header, a message: all of it can fail
        raise SchedulerError(f"{address} is no Dask scheduler: what it answers is not Dask's") from error
    raise SchedulerError(f"{address} is no Dask scheduler but a {kind}")


async def _kind(address: str, timeout: float) -> str:
    """Return what a server of Dask says it is; a client would wait without end for one that is silent."""
    distributed = imported("distributed")
    comm = await distributed.comm.connect(address, timeout=timeout)
    try:
        told = await distributed.core.send_recv(comm, op="identity")
    finally:
        comm.abort()
    return str(told["type"])


class Watch:
    """Whether a cluster is still there.

    Parameters
    ----------
    client : distributed.Client
        Of the cluster.
    """

    def __init__(self, client: Any) -> None:
        self.client, self.address = client, client.scheduler.address
        self.alive = monotonic()

    def connected(self) -> None:
        """Refuse to go on where the connection is lost.

        Raises
        ------
        SchedulerError
            If it is.
        """
        if self.client.status != "running":
            raise SchedulerError(f"scheduler {self.address} is gone; {GO_ON}")

    def begin(self) -> None:
        """Wait for the first worker, but not for long.

        Raises
        ------
        SchedulerError
            If none comes, or the connection is lost.
        """
        self.connected()
        if self.client.nthreads():
            return
        try:
            self.client.wait_for_workers(1, timeout=_ANSWER)
        except OSError as error:
            raise SchedulerError(f"scheduler {self.address} has no worker after {_ANSWER:g} s") from error

    def look(self) -> None:
        """Refuse to go on where the connection is lost, or where there has been no worker for too long.

        Raises
        ------
        SchedulerError
            If that is so.
        """
        self.connected()
        if self.client.nthreads():
            self.alive = monotonic()
        elif monotonic() - self.alive > _ALONE:
            raise SchedulerError(f"scheduler {self.address} has had no worker for {_ALONE:g} s; {GO_ON}")
