"""A node can serve its services itself, a few requests at a time, instead of its
executor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol, cast

from rclpy.service import Service

from dextar_control.contract.clocks import UnsteppedClock


class ServiceType(Protocol):
    """The type of a service, such as ``std_srvs.srv.Trigger``."""

    Request: type[object]
    Response: type[object]


def type_of(service: Service) -> ServiceType:
    """Return the type of a service."""
    return cast(ServiceType, service.srv_type)


class PolledServices:
    """Takes requests where they wait in the middleware, and answers them when it is
    told to.

    An executor serves every request that is there before it comes back to a
    subscription, so that a flood of calls holds a control loop up for as long as it
    lasts. Here the owner says how many are served, and when.

    Args:
        services: those of a node, asked for at each poll.
        complain: told of a request that could not be answered.
        clock: of ``received``.

    Attributes:
        served: requests so far.
        received: when the request being answered arrived here, ns of the clock.
    """

    def __init__(
        self,
        services: Callable[[], Iterable[Service]],
        complain: Callable[[str], object],
        clock: UnsteppedClock,
    ) -> None:
        self._clock = clock
        self._services = services
        self._complain = complain
        self._next = 0
        self.served = 0
        self.received = 0

    def poll(self, limit: int) -> int:
        """Serve at most ``limit`` waiting requests, one of each service before the
        second of any; return how many they were.
        """
        services = list(self._services())
        served = idle = 0
        while served < limit and idle < len(services):
            service = services[self._next % len(services)]
            self._next = (self._next + 1) % len(services)
            if self._serve(service):
                served, idle = served + 1, 0
            else:
                idle += 1
        self.served += served
        return served

    def _serve(self, service: Service) -> bool:
        """Answer one request of a service; where its callback fails that is told, and
        the response is empty.
        """
        kind = type_of(service)
        request, header = service.handle.service_take_request(kind.Request)
        if header is None:
            return False
        answer = cast(Callable[[object, object], object], service.callback)
        self.received = self._clock.arrival(
            int(getattr(header, "received_timestamp", 0))
        )
        try:
            response: object = answer(request, kind.Response())
        # A malformed request must not end a node that holds a robot.
        except Exception as error:
            self._complain(
                f"{service.service_name} failed: {type(error).__name__}: {error}"
            )
            response = kind.Response()
        try:
            service.send_response(response, header)
        except Exception as error:  # the caller is gone
            self._complain(f"{service.service_name} could not answer: {error}")
        return True
