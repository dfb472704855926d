"""Managed node: lifecycle, parameters, inputs and timers of every node of the suite."""

from __future__ import annotations

import contextlib
import functools
import gc
import heapq
import itertools
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, ParamSpec, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from spool_core.block import Block
from spool_core.errors import InputError
from spool_core.kernels.compiled import alone as one_at_a_time
from spool_core.kernels.kernel_files import COMPILING
from spool_core.node.block_hub import BlockHub
from spool_core.node.parameters import NodeParameter, Value, declare, read_parameters
from spool_core.node.stop import STOP, Phase

#: s of compiling after which the node reports it: cached kernels are loaded in less.
COMPILES = 3.0
#: s that a request or a transition waits for what another thread does with the same node: a state file on a
#: slow disk takes as long.
LONGEST_WAIT = 5.0
#: s between two looks at single samples, as long as a block of them is.
COLLECTS = 0.02

Message = TypeVar("Message")
P = ParamSpec("P")

#: What this process has compiled.
_COMPILED: set[Callable[[], object]] = set()

AUTOSTART = NodeParameter(
    "autostart", True, "Configure and activate at start, without a life cycle manager.", read_only=True
)


class ManagedNode(LifecycleNode):  # type: ignore[misc]  # rclpy carries no types
    """A table of parameters and four hooks that may raise.

    A subclass sets ``PARAMETERS`` and overrides :meth:`configure`, :meth:`activate`, :meth:`deactivate`,
    :meth:`cleanup`. What a hook raises is logged (an :class:`InputError` as one line, anything else with
    its traceback) and the transition returns FAILURE. Subscriptions and timers made with :meth:`subscribe`
    and :meth:`every` live while the node is active, services made with :meth:`serve` until its clean-up.

    This class alone uses private parts of rclpy (checked with 7.1.6), which has no public access to them:
    ``_parameter_overrides``, ``_state_machine`` and the handler of ``change_state``.
    """

    PARAMETERS: ClassVar[tuple[NodeParameter, ...]] = ()

    def __init__(
        self, name: str = "node", namespace: str | None = None, host: HostContext | None = None, **more: Any
    ) -> None:
        super().__init__(name, namespace=namespace, **more)
        #: Whether it is the only node of its process.
        self.alone = host is None
        self.host = host if host is not None else HostContext()
        self._lock = threading.RLock()
        self._left: deque[Callable[[], None]] = deque()
        self._while_active: list[Callable[[], object]] = []
        self._mailboxes: set[Subscription] = set()
        self._offered_services: list[Any] = []
        self._table = {parameter.name: parameter for parameter in (AUTOSTART, *self.PARAMETERS)}
        self._configured = False
        overrides = self._parameter_overrides
        of_others = self.host.of_others - set(self._table)
        declare(self, tuple(self._table.values()), {k: v for k, v in overrides.items() if k not in of_others})
        self._present: dict[str, Value] = {name: self.value(name) for name in self._table}
        self.add_on_set_parameters_callback(self._judge_change)
        self.add_post_set_parameters_callback(self._apply_change)

    @classmethod
    def read_file(cls, file: Path, node: str) -> dict[str, Value]:
        """Return the parameters that ``file`` gives a node of this class and the full name ``node``.

        Raises:
            InputError: the node would refuse the file.
        """
        return read_parameters(file, node, (AUTOSTART, *cls.PARAMETERS))

    #: Whether its host gave it up as hanging: it takes nothing until that has begun it again.
    given_up = False
    #: Whether a thread compiles, which can't be stopped: the process has to end without waiting for it.
    compiling = False

    # What a subclass overrides.

    def configure(self) -> None:
        """Read the parameters, make publishers, services and the core."""

    def activate(self) -> None:
        """Make subscriptions and timers."""

    def deactivate(self) -> None:
        """Finish what is under way; subscriptions and timers are gone already."""

    def cleanup(self) -> None:
        """Release what configure made."""

    def refuse_change(self, _changes: dict[str, Value]) -> str | None:
        """Return why these parameters can't be taken together, or ``None``; no side effects.

        It is asked for every change, and for all values together when the node is configured.
        """
        return None

    def apply_change(self, changes: dict[str, Value]) -> None:
        """Make accepted parameter changes effective."""

    # What a subclass uses.

    @property
    def given(self) -> set[str]:
        """Names of the parameters that were given at start."""
        return set(self._parameter_overrides)

    def value(self, name: str) -> Any:
        """Return the present value of a declared parameter."""
        return self.get_parameter(name).value

    def subscribe(
        self,
        message_type: type[Message],
        topic: str,
        callback: Callable[[Message], None],
        qos: QoSProfile,
        *,
        raw: bool = False,
    ) -> Any:
        """Subscribe while active; an exception in ``callback`` is logged, the node lives on."""
        subscription = self.create_subscription(message_type, topic, self._guarded(callback), qos, raw=raw)
        self._while_active.append(lambda: self.destroy_subscription(subscription))
        return subscription

    def open_mailbox(self, message_type: type[Message], topic: str, profile: QoSProfile) -> Mailbox:
        """Subscribe without the executor, whose turn costs twice what taking a message does."""
        # The callback is never called: no executor knows of the subscription.
        subscription = self.create_subscription(message_type, topic, lambda _: None, profile, raw=True)
        self._mailboxes.add(subscription)
        return Mailbox(subscription)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions that an executor serves."""
        yield from (one for one in super().subscriptions if one not in self._mailboxes)

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription, that of a mailbox as well."""
        self._mailboxes.discard(subscription)
        return bool(super().destroy_subscription(subscription))

    def collect(
        self, sources: Sequence[tuple[type[Any], str, Callable[[bytes, int], None]]], profile: QoSProfile
    ) -> None:
        """Pass serialized messages and their arrival times (ns) to the callback of each topic while active.

        What came of all topics is taken every :data:`COLLECTS` s, in the order of its arrival: a turn of an
        executor for each of a thousand messages a second costs more than what they are for.
        """
        boxes = [(self.open_mailbox(kind, topic, profile), take) for kind, topic, take in sources]
        self._while_active += [
            functools.partial(self.destroy_subscription, box.subscription) for box, _ in boxes
        ]

        def take_all() -> None:
            came = [(at, data, take) for box, take in boxes for data, at in box.arrivals()]
            for at, data, take in sorted(came, key=lambda one: one[0]):
                try:
                    take(data, at)
                except Exception as error:
                    self._log_failure("a message could not be handled", error)

        self.every(COLLECTS, take_all, steady=True)

    def subscribe_blocks(
        self, topic: str, take: Callable[[Sequence[Block]], None], room: Callable[[], int]
    ) -> None:
        """Pass the blocks of ``topic`` to ``take`` while active; their samples are views of the messages.

        Until ``room()`` samples have come they may wait for each other in a process that hosts many nodes.
        """
        self._while_active.append(self.host.hub.subscribe(self, topic, self._guarded(take), room))

    def every(self, period: float, callback: Callable[[], None], *, steady: bool = False) -> Any:
        """Call back every ``period`` s while active, on the node's clock or on a steady one."""
        if steady and self.host.ticker is not None:
            self._while_active.append(self.host.ticker.every(period, self._guarded(callback)))
            return None
        clock = _steady_clock() if steady else None
        timer = self.create_timer(period, self._guarded(callback), clock=clock)
        self._while_active.append(lambda: self.destroy_timer(timer))
        return timer

    def serve(self, service_type: Any, name: str, answer: Callable[[Any, Any], Any]) -> None:
        """Offer a service until the clean-up; ``answer`` gets request and response and returns the response.

        Only an active node takes requests, an inactive one refuses them. What ``answer`` raises is logged; an
        :class:`InputError` is a refusal, said in the response's ``reason``, or ``message`` as standard
        services have it.
        """

        def guarded(request: Any, response: Any) -> Any:
            try:
                with self._alone_in_it():
                    if self._life != "active":
                        raise InputError(
                            f"{self.get_fully_qualified_name()} is {self._life}: activate it first"
                        )
                    return answer(request, response)
            except InputError as error:
                said = str(error)
            except Exception as error:
                self._log_failure(f"{name} failed", error)
                said = f"{name} failed: see the node's log"
            response.success = False
            setattr(response, "reason" if hasattr(response, "reason") else "message", said)
            return response

        self._offered_services.append(self.create_service(service_type, name, guarded))

    def destroy_publisher(self, publisher: Any) -> bool:
        """Destroy a publisher, one of the life cycle as well."""
        return bool(self.destroy_lifecycle_publisher(publisher))

    def abandon(self) -> None:
        """Release what an interrupted transition made; what it had not made yet is no fault."""
        self._go_quiet()
        with contextlib.suppress(Exception):
            self._let_go()

    def compile(self, kernels: Callable[[], object]) -> None:
        """Run ``kernels``, which compiles, one process at a time; it is logged, and a signal breaks it off.

        In a process it is done once. It runs on a thread: an exception out of a signal's handler would be
        lost in the compiler's callbacks.
        """
        if kernels in _COMPILED:
            return
        failure: list[Exception] = []

        def work() -> None:
            try:
                with one_at_a_time():
                    kernels()
            except Exception as error:
                failure.append(error)

        thread = threading.Thread(target=work, daemon=True)
        phase, self.compiling = STOP.phase, True
        STOP.phase = Phase.STARTING if phase is Phase.RUNNING else phase
        begin, told = time.monotonic(), False
        thread.start()
        while thread.is_alive():
            thread.join(0.1)
            self.host.beat()
            if not told and time.monotonic() - begin > COMPILES:
                self.get_logger().info(f"{COMPILING}: it may take a minute")
                told = True
        STOP.phase = phase if STOP.phase is Phase.STARTING else STOP.phase
        self.compiling = False
        if told:
            self.get_logger().info(f"kernels ready after {time.monotonic() - begin:.0f} s")
        if failure:
            raise failure[0]
        _COMPILED.add(kernels)

    # Transitions.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run :meth:`configure` with values that fit each other."""
        refused = self._transition("configure", self._check_together)
        refused = refused or self._transition("configure", self.configure, undo=self._let_go)
        self._configured = refused is None
        return refused or super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the publishers, then run :meth:`activate`."""
        result = super().on_activate(state)
        result = self._transition("activate", self.activate, undo=self._go_quiet) or result
        if result == TransitionCallbackReturn.SUCCESS:
            self.get_logger().info("active")
        if self.alone:
            # Looking through all that the libraries hold stops a process for 0.1 s: what lives now stays.
            gc.collect()
            gc.freeze()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Drop subscriptions and timers, then run :meth:`deactivate`."""
        self._go_quiet()
        refused = self._transition("deactivate", self.deactivate)
        if refused is None:
            self.get_logger().info("inactive")
        return refused or super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Run :meth:`cleanup`."""
        self._configured = False
        return self._transition("clean up", self._let_go) or super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop from any state."""
        self._go_quiet()
        if state.label == "active":
            self._transition("deactivate", self.deactivate)
        if state.label != "unconfigured":
            self._transition("clean up", self._let_go)
        return super().on_shutdown(state)

    def on_error(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Return to unconfigured, from where the node can be configured again."""
        self.abandon()
        return TransitionCallbackReturn.SUCCESS

    def _check_together(self) -> None:
        refusal = self.refuse_change({name: self.value(name) for name in self._table})
        if refusal is not None:
            raise InputError(f"{self.get_fully_qualified_name()}: {refusal}")

    def _transition(
        self, name: str, hook: Callable[[], None], undo: Callable[[], None] | None = None
    ) -> TransitionCallbackReturn | None:
        """Run ``hook``; return FAILURE where it raised, else ``None``."""
        try:
            with self._alone_in_it():
                hook()
        except Exception as error:
            self._log_failure(f"can't {name}", error)
            if undo is not None:
                undo()
            return TransitionCallbackReturn.FAILURE
        return None

    def _go_quiet(self) -> None:
        while self._while_active:
            self._while_active.pop()()

    def _let_go(self) -> None:
        while self._offered_services:
            self.destroy_service(self._offered_services.pop())
        self.cleanup()

    @property
    def _life(self) -> str:
        return str(self._state_machine.current_state[1])

    @property
    def is_inactive(self) -> bool:
        """Whether it is configured and not active."""
        return self._life == "inactive"

    @property
    def busy(self) -> bool:
        """Whether a callback of it runs on another thread."""
        if not self._lock.acquire(blocking=False):
            return True
        self._lock.release()
        return False

    def give_up(self) -> None:
        """Take nothing any more, as a callback hangs, until :meth:`admit`."""
        self.given_up = True
        self._left.clear()

    def admit(self) -> None:
        """Take what comes again."""
        self.given_up = False

    def _guarded(self, callback: Callable[P, None]) -> Callable[P, None]:
        # wraps: rclpy tells callbacks with message info apart by their signature.
        @functools.wraps(callback)
        def guarded(*arguments: P.args, **named: P.kwargs) -> None:
            if self.given_up:
                return
            # Only where a process hosts many nodes do two threads call the same one. Neither waits for the
            # other: what comes meanwhile is left to the one that is at it.
            self._left.append(lambda: callback(*arguments, **named))
            self._run_left()

        return guarded

    def _run_left(self) -> None:
        while self._left and self._lock.acquire(blocking=False):
            try:
                while self._left and not self.given_up:
                    try:
                        self._left.popleft()()
                    except Exception as error:
                        self._log_failure("a message could not be handled", error)
                if self.given_up:
                    self._left.clear()
            finally:
                self._lock.release()

    @contextlib.contextmanager
    def _alone_in_it(self) -> Iterator[None]:
        """Hold up callbacks of this node on other threads.

        Raises:
            InputError: one of them does not end.
        """
        if self.given_up or not self._lock.acquire(timeout=LONGEST_WAIT):
            name = self.get_fully_qualified_name()
            raise InputError(f"{name}: node is busy (a callback is still running); try again later")
        try:
            yield
        finally:
            self._lock.release()
            self._run_left()

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:  # noqa: N802
        """Answer a transition that the present state does not have: rclpy would end the process."""
        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)
        except rclpy_implementation.RCLError as error:
            self.get_logger().warning(f"transition refused: {' '.join(str(error).split())}")
            response.success = False
            return response

    def _log_failure(self, what: str, error: Exception) -> None:
        text = str(error) if isinstance(error, InputError) else traceback.format_exc()
        self.get_logger().error(f"{what}: {text}")

    def _judge_change(self, parameters: list[RosParameter]) -> SetParametersResult:
        changes = {parameter.name: parameter.value for parameter in parameters}
        for name, value in changes.items():
            known = self._table.get(name)
            if known is None:
                continue
            refusal = known.refusal(value)
            changed = value != self._present[name]
            if refusal is None and changed and known.read_only:
                refusal = f"{name} is fixed at start: start the node with the new value"
            if refusal is None and changed and known.structural and self._configured:
                refusal = f"{name} changes only while the node is unconfigured: deactivate, clean up first"
            if refusal is not None:
                return SetParametersResult(successful=False, reason=refusal)
        refusal = self.refuse_change(changes)
        return SetParametersResult(successful=refusal is None, reason=refusal or "")

    def _apply_change(self, parameters: list[RosParameter]) -> None:
        changes = {
            parameter.name: parameter.value
            for parameter in parameters
            if parameter.name in self._table and parameter.value != self._present[parameter.name]
        }
        if not changes:
            return
        said = ", ".join(f"{name} from {self._present[name]} to {value}" for name, value in changes.items())
        try:
            with self._alone_in_it():
                self.apply_change(changes)
        except InputError as error:
            self._log_failure("a change of parameters takes no effect", error)
            return
        self._present.update(changes)
        # Who asked is not told by ROS 2; the change itself travels on /parameter_events as well.
        self.get_logger().info(f"parameters changed: {said}")


@dataclass(slots=True)
class Mailbox:
    """Subscription whose messages wait until they are asked for, as many as its profile keeps."""

    subscription: Subscription

    def empty(self) -> Iterator[bytes]:
        """Return the serialized messages that came."""
        return (data for data, _ in self.arrivals())

    def arrivals(self) -> Iterator[tuple[bytes, int]]:
        """Return the serialized messages that came, each with its arrival (ns, system's clock)."""
        handle = self.subscription.handle
        with handle:
            while (taken := handle.take_message(self.subscription.msg_type, True)) is not None:
                yield taken[0], taken[1]["received_timestamp"]


class Ticker:
    """Calls due functions in :meth:`run`; its host does that every :data:`STEP` s.

    The events executor looks through all timers of a clock at each of their turns, so that those of a hundred
    valves would cost more than what they do.
    """

    #: s, a tenth of the shortest period that a node asks for, and what a block waits at most to be heard.
    STEP = 0.01

    def __init__(self) -> None:
        self._due: list[tuple[float, int, float, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._ended: set[int] = set()

    def every(self, period: float, callback: Callable[[], None]) -> Callable[[], None]:
        """Call back every ``period`` s from now on; return what ends it."""
        number = next(self._numbers)
        # Those that begin together are spread over the period.
        phase = (number * 0.618) % 1.0
        heapq.heappush(self._due, (time.monotonic() + phase * period, number, period, callback))
        return lambda: self._ended.add(number)

    def run(self) -> None:
        """Call what is due; what is late is called once."""
        now = time.monotonic()
        while self._due and self._due[0][0] <= now:
            due, number, period, callback = heapq.heappop(self._due)
            if number in self._ended:
                self._ended.discard(number)
                continue
            callback()
            later = due + period if due + period > now else now + period
            heapq.heappush(self._due, (later, number, period, callback))


@dataclass(slots=True)
class HostContext:
    """Context of the nodes of a process, which its host hands to each; a node by itself has its own.

    Attributes:
        hub: who gets the blocks of which topic.
        ticker: calls on a steady clock; ``None``: by timers of the node.
        of_others: parameters that nodes may be given although they are those of other nodes.
        beat: called now and then where something takes long, so that nobody takes it for hanging.
    """

    hub: BlockHub = field(default_factory=BlockHub)
    ticker: Ticker | None = None
    of_others: set[str] = field(default_factory=set)
    beat: Callable[[], None] = lambda: None


@functools.cache
def _steady_clock() -> Clock:
    """Return the one steady clock of this process: the events executor keeps a thread for each clock."""
    return Clock(clock_type=ClockType.STEADY_TIME)
