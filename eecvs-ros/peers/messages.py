"""Messages of any type, found by name and filled with values that differ in every field."""

import array
import importlib
import random
import struct


def message_class(name):
    """Of a type such as std_msgs/msg/Header."""
    package, _, base = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), base)


def fill(message, number, length):
    """Values of message number `number`; sequences of bytes and floats have `length` bytes."""
    _fill(message, number, length, random.Random(number))
    if hasattr(message, "seq"):
        message.seq = number
    return message


def _fill(message, number, length, chance):
    for field, kind in message.get_fields_and_field_types().items():
        setattr(message, field, _value(kind, number, length, chance))


def _value(kind, number, length, chance):
    if kind == "sequence<uint8>":
        return array.array("B", chance.randbytes(length))
    if kind == "sequence<float>":
        return array.array("f", [chance.randrange(-1000, 1000) / 8 for _ in range(length // 4)])
    if kind.startswith("sequence<"):
        inner = kind[len("sequence<") : -1]
        return [_value(inner, number, length, chance) for _ in range(number % 3 + 1)]
    if kind == "string":
        return "".join(chance.choice("abcdefgh_") for _ in range(number % 7))
    if kind == "boolean":
        return number % 2 == 1
    if kind == "octet":
        return bytes([chance.randrange(4)])
    if kind in ("float", "double"):
        return chance.randrange(-(10**6), 10**6) / 64
    if kind.startswith(("int", "uint")):
        bits = int(kind.lstrip("uint")) - (not kind.startswith("u"))
        return chance.randrange(2**bits)
    return _fields(kind, number, length, chance)


def _fields(kind, number, length, chance):
    package, base = kind.split("/")
    message = message_class(f"{package}/msg/{base}")()
    _fill(message, number, length, chance)
    if kind == "builtin_interfaces/Time":
        message.nanosec %= 10**9
    return message


# Of struct, by the names of ROS.
NUMBERS = {
    "boolean": "?", "octet": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float": "f", "double": "d",
}


def cdr(message):
    """The bytes of a message, with padding of zeros: Fast DDS leaves there what was in its memory."""
    out = bytearray()
    _put_fields(message, out)
    return b"\0\1\0\0" + bytes(out)


def _put_fields(message, out):
    for field, kind in message.get_fields_and_field_types().items():
        _put(getattr(message, field), kind, out)


def _put(value, kind, out):
    if kind.startswith("sequence<"):
        inner = kind[len("sequence<") : -1]
        _put(len(value), "uint32", out)
        if inner == "uint8":
            out += bytes(value)
        else:
            for item in value:
                _put(item, inner, out)
    elif kind == "string":
        text = value.encode() + b"\0"
        _put(len(text), "uint32", out)
        out += text
    elif kind in NUMBERS:
        letter = NUMBERS[kind]
        out += bytes(-len(out) % struct.calcsize(letter))
        out += struct.pack(f"<{letter}", value[0] if kind == "octet" else value)
    else:
        _put_fields(value, out)
