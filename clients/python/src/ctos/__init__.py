"""Event handlers of CTOS in Python: JSON lines on standard input and output.

A program declares what it takes with `@handler`, asks others with `call` and `send`, and gives itself to `run()`::

    import ctos

    @ctos.handler
    def double(number: int) -> int:
        return 2 * number

    ctos.run()

One message is handled at a time. `print` goes to standard error, because standard output belongs to the protocol.
A program that is to run in virtual time reads no clock, draws from `rng()` only, and starts no threads.
"""

from __future__ import annotations

import base64
import inspect
import json
import os
import random
import sys
import traceback
from collections import deque
from dataclasses import asdict, dataclass, field, is_dataclass
from typing import Any, BinaryIO, Callable, NoReturn, Optional

__all__ = [
    "Answer", "CallError", "Refused", "args", "at", "call", "finish", "handler", "keep", "log", "on_run",
    "on_stop", "opaque", "rng", "run", "send", "service_object", "state", "task", "unwrap",
]

PROTOCOL = 1
# Fewer bytes go as base64.
LEAST_FRAME = 1 << 16


class CallError(Exception):
    """What another task did not answer, in words."""


class Refused(Exception):
    """Raised in a handler: the caller is told the text. (Any other exception is told, too, and logged with its traceback.)"""


@dataclass
class Answer:
    """What a service object answers: text, floats, whole numbers."""

    text: str = ""
    floats: list[float] = field(default_factory=list)
    ints: list[int] = field(default_factory=list)


_handlers: dict[str, Callable[..., Any]] = {}
_declared: list[dict[str, Any]] = []
_object: Optional[Callable[..., Any]] = None
_on_run: Optional[Callable[[], None]] = None
_on_stop: Optional[Callable[[str], None]] = None
_hello: dict[str, Any] = {}
_state: Any = None
_rng = random.Random()
_waiting: deque[dict[str, Any]] = deque()
_next = 1
# The folder of frames, and how many were written.
_frames: Optional[str] = None
_framed = 0
_input: BinaryIO = sys.stdin.buffer
_output: BinaryIO = sys.stdout.buffer


def handler(
    function: Optional[Callable[..., Any]] = None,
    *,
    name: Optional[str] = None,
    request: Optional[dict[str, Any]] = None,
    reply: Any = None,
) -> Any:
    """Takes the command that is called as the function is, or `name`.

    The fields of the request are its arguments by name. What it returns is the reply: a value, a dictionary, a dataclass.
    `request` and `reply` are their types with units, for `declares = "hello"`; without them the annotations count.
    """

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        command = name or function.__name__
        _handlers[command] = function
        _declared.append({"name": command, "function": function, "request": request, "reply": reply})
        return function

    return register(function) if function else register


def service_object(function: Callable[..., Any]) -> Callable[..., Any]:
    """Makes the program a service object: `program.TASK EXEC TEXT FMSG 2 1.5 2` calls `function(text, floats, ints)`.

    It returns an `Answer`, a text, a float, or a list of floats.
    """
    global _object
    _object = function
    return function


def on_run(function: Callable[[], None]) -> Callable[[], None]:
    """Called once, when all tasks of the app are there: where a program that asks others begins."""
    global _on_run
    _on_run = function
    return function


def on_stop(function: Callable[[str], None]) -> Callable[[str], None]:
    """Called before the program ends, with the reason. It may take as long as `grace_s` of the configuration."""
    global _on_stop
    _on_stop = function
    return function


def call(to: str, command: str, /, *, deadline_s: Optional[float] = None, **data: Any) -> Any:
    """Asks the task `to`, and waits for its reply.

    Raises `CallError`: it refused, it is gone, it was late, the data does not fit, or the configuration names it not in `asks`.
    """
    asked = _asked(to, command, data)
    if deadline_s is not None:
        asked["deadline_s"] = deadline_s
    _write({"call": asked})
    while True:
        line = _read()
        if line is None:
            sys.exit(0)
        for kind in ("reply", "error"):
            if kind in line and line[kind]["id"] == asked["id"]:
                if kind == "error":
                    raise CallError(line[kind]["text"])
                return line[kind].get("data")
        _waiting.append(line)


def send(to: str, command: str, /, **data: Any) -> None:
    """Sends the task `to` a message that needs no answer. What goes wrong is logged."""
    _write({"send": _asked(to, command, data)})


def opaque(value: Any) -> bytes:
    """The bytes that a field of type `bytes` has: they come as base64, or as a frame in shared memory, which is read once."""
    if isinstance(value, dict) and set(value) == {"frame", "bytes"} and _frames is not None:
        path = os.path.join(_frames, os.path.basename(value["frame"]))
        with open(path, "rb") as file:
            read = file.read()
        os.unlink(path)
        return read
    return base64.b64decode(value)


def unwrap(reply: Any) -> Any:
    """The value of a reply that is `{"Ok": value}`; `CallError` for `{"Err": why}`."""
    if isinstance(reply, dict) and set(reply) == {"Ok"}:
        return reply["Ok"]
    if isinstance(reply, dict) and set(reply) == {"Err"}:
        raise CallError(json.dumps(reply["Err"]))
    return reply


def keep(value: Any) -> None:
    """Keeps `value`: the next program of this task finds it in `state()`, after a crash or at another place."""
    global _state
    _state = value
    _write({"keep": {"state": _plain(value)}})


def state() -> Any:
    """What was kept last, also by the program before this one; `None` at first."""
    return _state


def args() -> Any:
    """`args` of the task's arguments."""
    return _hello.get("args")


def task() -> str:
    """The name of the task."""
    return str(_hello.get("task", ""))


def rng() -> random.Random:
    """Random numbers that depend on the app's seed and the task's name only."""
    return _rng


def log(text: str, level: str = "info") -> None:
    """Logs a line: `debug`, `info`, `warning` or `error`."""
    _write({"log": {"level": level, "text": text}})


def at(text: str) -> None:
    """Says what the program does, for `ctos status` and displays."""
    _write({"at": {"text": text}})


def finish(ok: bool, text: str = "") -> None:
    """Ends the app, if its `until` names this task."""
    _write({"finish": {"ok": ok, "text": text}})


def run(*, deterministic: bool = True, frames: bool = False) -> NoReturn:
    """Serves until the task is stopped.

    `deterministic`: the same lines lead to the same lines. Without that it is refused in virtual time.
    `frames`: bytes of more than 64 kB go through shared memory, in both directions; handlers read them by `opaque(value)`.
    """
    if sys.argv[1:] == ["--declare"]:
        print(_declaration(deterministic))
        sys.exit(0)
    global _input, _output, _hello, _state, _rng, _frames
    # Whatever prints, in whatever library, does not write into the protocol.
    _output = os.fdopen(os.dup(1), "wb", buffering=0)
    _input = os.fdopen(os.dup(0), "rb")
    os.dup2(2, 1)
    with open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), 0)
    line = _read()
    if line is None or "hello" not in line:
        sys.exit("this program is started by a task: handler = \"ctos.program\"")
    _hello = line["hello"]
    if _hello["protocol"] != PROTOCOL:
        sys.exit(f"this client speaks version {PROTOCOL} of the protocol, the task {_hello['protocol']}")
    _state = _hello.get("state")
    _frames = _hello.get("frames") if frames else None
    _rng = random.Random(f"{_hello['seed']} {_hello['task']}")
    # Types are told to who asks for them alone: otherwise the file beside the program has them.
    commands = [_types(declared) if _hello.get("declare") else {"name": declared["name"]} for declared in _declared]
    hello = {"protocol": PROTOCOL, "deterministic": deterministic, "frames": _frames is not None, "commands": commands}
    _write({"hello": hello})
    while True:
        line = _waiting.popleft() if _waiting else _read()
        if line is None:
            sys.exit(0)
        _take(line)


def _take(line: dict[str, Any]) -> None:
    if "message" in line:
        _handle(line["message"])
    elif "run" in line and _on_run:
        _on_run()
    elif "error" in line:
        print("not sent:", line["error"]["text"], file=sys.stderr)
    elif "stop" in line:
        if _on_stop:
            _on_stop(line["stop"]["reason"])
        sys.exit(0)


def _handle(message: dict[str, Any]) -> None:
    number, command, data = message["id"], message["command"], message.get("data") or {}
    try:
        if command == "ask_object":
            reply = _ask_object(data)
        else:
            function = _handlers.get(command)
            if function is None:
                raise Refused(f"the program has no handler for `{command}`")
            reply = function(**data)
        written = _line({"reply": {"id": number, "data": _plain(reply)}})
    except Refused as why:
        written = _line({"error": {"id": number, "text": str(why)}})
    except CallError as why:
        written = _line({"error": {"id": number, "text": str(why)}})
    except Exception as why:
        traceback.print_exc()
        written = _line({"error": {"id": number, "text": f"{type(why).__name__}: {why}"}})
    _put(written)


def _ask_object(data: dict[str, Any]) -> dict[str, Any]:
    if _object is None:
        raise Refused("the program is no service object")
    answer = _object(data["text"], data["floats"], data["ints"])
    if isinstance(answer, Answer):
        return asdict(answer)
    if isinstance(answer, str):
        return asdict(Answer(text=answer))
    if isinstance(answer, (int, float)):
        return asdict(Answer(floats=[float(answer)]))
    return asdict(Answer(floats=[float(number) for number in answer or []]))


def _asked(to: str, command: str, data: dict[str, Any]) -> dict[str, Any]:
    global _next
    number, _next = _next, _next + 1
    return {"id": number, "task": to, "command": command, "data": _plain(data) or None}


def _plain(value: Any) -> Any:
    """The value as JSON has it: bytes become base64, dataclasses and what NumPy has become lists and numbers."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (bytes, bytearray, memoryview)):
        return _frame(value) if _frames is not None and len(value) >= LEAST_FRAME else base64.b64encode(value).decode("ascii")
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    raise TypeError(f"{type(value).__name__} has no JSON")


def _frame(value: Any) -> dict[str, Any]:
    """A frame of these bytes: who reads the line removes it."""
    global _framed
    _framed += 1
    name = f"p{_framed}"
    with open(os.path.join(_frames or "", name), "xb") as file:
        file.write(value)
    return {"frame": name, "bytes": memoryview(value).nbytes}


def _line(line: dict[str, Any]) -> bytes:
    return json.dumps(line, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _write(line: dict[str, Any]) -> None:
    _put(_line(line))


def _put(line: bytes) -> None:
    left = memoryview(line)
    while left:
        left = left[_output.write(left) :]


def _read() -> Optional[dict[str, Any]]:
    """The next line that is not a step; `None` at the end of the input."""
    while True:
        text = _input.readline()
        if not text:
            return None
        line: dict[str, Any] = json.loads(text)
        # All lines before it have been dealt with, or wait for an answer.
        if "step" not in line:
            return line
        _write(line)


_TYPES = {int: "int", float: "float", str: "text", bool: "bool", bytes: "bytes"}


def _type(annotation: Any) -> str:
    if annotation in _TYPES:
        return json.dumps(_TYPES[annotation])
    name = str(annotation)
    for python, declared in (("int", "int"), ("float", "float"), ("str", "text"), ("bool", "bool"), ("bytes", "bytes")):
        if name == python:
            return json.dumps(declared)
        if name.replace("typing.", "").lower() == f"list[{python}]":
            return json.dumps([declared])
    return json.dumps("float")


def _types(declared: dict[str, Any]) -> dict[str, Any]:
    """What a command takes and gives, with its help."""
    about = inspect.signature(declared["function"])
    request, reply = declared["request"], declared["reply"]
    if request is None:
        request = {name: json.loads(_type(one.annotation)) for name, one in about.parameters.items()}
    if reply is None:
        gives = about.return_annotation
        reply = "nothing" if gives in (None, "None", inspect.Signature.empty) else json.loads(_type(gives))
    help = (inspect.getdoc(declared["function"]) or "").split("\n")[0]
    return {"name": declared["name"], "help": help, "request": request, "reply": reply}


def _toml(value: Any) -> str:
    """A type as TOML has it."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_toml(one)}" for name, one in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(one) for one in value) + "]"
    return json.dumps(value)


def _declaration(deterministic: bool) -> str:
    lines = [f"deterministic = {json.dumps(deterministic)}"]
    for declared in _declared:
        types = _types(declared)
        lines += [
            "", f"[command.{types['name']}]", f"help = {json.dumps(types['help'])}", f"request = {_toml(types['request'])}",
            f"reply = {_toml(types['reply'])}",
        ]
    return "\n".join(lines)
