"""A managed node adds the lifecycle of ROS 2 to the package's own kind of node."""

from __future__ import annotations

from collections.abc import Callable

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from dextar_control.contract.errors import DextarError
from dextar_control.nodekit.node import DextarNode

UNCONFIGURED, ACTIVE = "unconfigured", "active"
SUCCESS = TransitionCallbackReturn.SUCCESS


class ManagedNode(LifecycleNodeMixin, DextarNode):
    """A node with lifecycle states; what a transition does is in ``configure``,
    ``activate``, ``deactivate`` and ``cleanup``.

    A transition that raises a DextarError is refused with its message, and the node
    stays in the state where it was; any other exception leads by way of error
    processing to unconfigured. A transition that the present state does not have is
    refused too (rclpy's own service raises then, out of the executor). No executor
    serves the services: the node polls ``polled_services``.
    """

    def __init__(self) -> None:
        DextarNode.__init__(self, served=False)
        LifecycleNodeMixin.__init__(self)
        self.transition_error: DextarError | None = None
        self._service_change_state.callback = self._on_change_state

    @property
    def lifecycle(self) -> str:
        """The state's name: unconfigured, inactive, active, finalized, or that of the
        transition under way.
        """
        return str(self._state_machine.current_state[1])

    def why_fixed(self) -> str:
        """Return why parameters that are not live cannot be changed; only an
        unconfigured node takes them.
        """
        return (
            ""
            if self.lifecycle == UNCONFIGURED
            else f"while the node is {self.lifecycle}; clean it up first"
        )

    def change_state(self, transition: int) -> bool:
        """Make a transition, one of ``lifecycle_msgs/msg/Transition``; return False
        where it is refused, and the log says why.
        """
        triggers: dict[int, Callable[[], TransitionCallbackReturn]] = {
            Transition.TRANSITION_CONFIGURE: self.trigger_configure,
            Transition.TRANSITION_ACTIVATE: self.trigger_activate,
            Transition.TRANSITION_DEACTIVATE: self.trigger_deactivate,
            Transition.TRANSITION_CLEANUP: self.trigger_cleanup,
        }
        possible = self._possible()
        if transition not in possible:
            self._refuse_transition(str(transition))
            return False
        before, label = self.lifecycle, possible[transition]
        self.transition_error = None
        done = bool(triggers.get(transition, self.trigger_shutdown)() == SUCCESS)
        if done:
            self.get_logger().info(f"{label}: {before} -> {self.lifecycle}")
        self.on_transition()
        return done

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        wanted = request.transition.id
        if request.transition.label:
            labels = {label: number for number, label in self._possible().items()}
            if request.transition.label not in labels:
                self._refuse_transition(f"'{request.transition.label}'")
                return response
            wanted = labels[request.transition.label]
        response.success = self.change_state(wanted)
        return response

    def _possible(self) -> dict[int, str]:
        """Return the labels of the transitions from here, by their numbers."""
        found = self._state_machine.available_transitions
        return {number: label for number, label, *_ in found}

    def _refuse_transition(self, transition: str) -> None:
        self.get_logger().error(
            f"transition {transition} is not possible in state {self.lifecycle};"
            f" possible are: {', '.join(sorted(self._possible().values())) or 'none'}"
        )

    def _try(self, name: str) -> TransitionCallbackReturn:
        try:
            getattr(self, name)()
        except DextarError as error:
            self.transition_error = error
            self.get_logger().error(f"{name} is refused: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # which rclpy would swallow without a word
            self.get_logger().error(f"{name} failed: {type(error).__name__}: {error}")
            return TransitionCallbackReturn.ERROR
        return SUCCESS

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to inactive."""
        return self._try("configure")

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to active."""
        return self._try("activate")

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to inactive."""
        return self._try("deactivate")

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to unconfigured."""
        return self._try("cleanup")

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to finalized, by way of what the present state needs."""
        if state.label == ACTIVE:
            self._try("deactivate")
        return SUCCESS if state.label == UNCONFIGURED else self._try("cleanup")

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go to unconfigured from where a transition failed; to finalized where even
        that fails.
        """
        self._try("deactivate")
        return self._try("cleanup")

    def destroy_node(self) -> None:
        """Leave the graph, with the state machine, which rclpy itself would leave
        there.
        """
        self._state_machine.destroy_when_not_in_use()
        super().destroy_node()

    def configure(self) -> None:
        """Build everything from the parameters; raise a DextarError to stay
        unconfigured.
        """

    def activate(self) -> None:
        """Begin the node's work; raise a DextarError to stay inactive."""

    def deactivate(self) -> None:
        """End what ``activate`` began, also when that failed halfway."""

    def cleanup(self) -> None:
        """Drop what ``configure`` built, also when that failed halfway."""

    def on_transition(self) -> None:
        """Called after each transition, made or refused."""
