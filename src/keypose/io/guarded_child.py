# pyright: basic
"""The throw-away process in which a native library reads files; it imports nothing of keypose and is never imported by it.

Called as ``python guarded_child.py`` with one JSON object on standard input: ``reader``, the file of the module that reads,
``memory_bytes`` that it may take beside the library, and ``files``, a list of paths with seconds and bytes that each may
take. To standard output, a file, goes one record for each: blocks of a tag, a length and that many bytes, first the arrays,
then a JSON object that says what they are and where in the record. A record without its JSON means that the process was
killed or crashed on that file.

The reading module has ``start()``, which imports the library, ``understood(record, path)``, which puts arrays into the
record and returns the facts, and ``reason(error)``, which puts an error of the library into words or returns None.
"""

import json
import math
import os
import struct
import sys
import types
from array import array
from importlib.machinery import SourceFileLoader

ARRAY, FACTS = b"array   ", b"facts   "
SIZES = {"d": 8, "f": 4, "e": 2, "I": 4, "i": 4, "B": 1}


class Refusal(Exception):
    """What is wrong with the file, and where."""

    def __init__(self, where, what):
        super().__init__(what)
        self.where, self.what = where, what


class Record:
    """One file's arrays on their way out; what is written is not kept in memory."""

    def __init__(self, out, most_bytes):
        self._out, self._length, self._most = out, 0, most_bytes

    def put(self, kind, data, width=0):
        """Store bytes of an array of ``kind``; returns what finds it again."""
        data = bytes(data)
        at = self._length + 16
        self._length = at + len(data)
        if self._length > self._most:
            self.refuse("", f"it holds more than {self._most >> 20} MiB")
        self._out.write(ARRAY + struct.pack("<Q", len(data)))
        self._out.write(data)
        return {"at": at, "kind": kind, "count": len(data) // SIZES[kind], "width": width}

    def reals(self, values, width=0):
        """Any iterable of floats."""
        return self.put("d", array("d", values).tobytes(), width)

    def refuse(self, where, what):
        """Give the file up."""
        raise Refusal(where, what)

    def finish(self, facts):
        """End the record."""
        text = json.dumps(facts).encode()
        self._out.write(FACTS + struct.pack("<Q", len(text)))
        self._out.write(text)
        self._out.flush()


def read(path, out, most_bytes, reader):
    """One file as one record; what is wrong with it is a record too."""
    record = Record(out, most_bytes)
    try:
        facts = reader.understood(record, path)
    except Refusal as error:
        facts = {"error": error.what, "where": error.where}
    except MemoryError:
        facts = {"error": "it needs too much memory", "where": "", "kind": "MemoryError"}
    except Exception as error:
        facts = reader.reason(error) or {"error": f"{type(error).__name__}: {error}", "where": "", "kind": "internal"}
    record.finish(facts)


def used_addresses():
    """Bytes of addresses that the library has taken already, most of them never used; a guess where nothing says so."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return 1 << 30


def set_memory_limit(memory_bytes):
    """A limit where the system has one, and no core dumps."""
    try:
        import resource
    except ImportError:
        return None
    for kind, value in ((resource.RLIMIT_AS, memory_bytes), (resource.RLIMIT_CORE, 0)):
        try:
            _, hard = resource.getrlimit(kind)
            limit = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(kind, (limit, hard))
        except (OSError, ValueError):  # the system does not know it
            continue
    return resource


def set_time_limit(resource, cpu_s):
    """From now on so many seconds of computing; then the process is killed."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    limit = math.ceil(used.ru_utime + used.ru_stime + cpu_s)
    resource.setrlimit(resource.RLIMIT_CPU, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def load(path):
    """A module by its file."""
    module = types.ModuleType("reader")
    SourceFileLoader("reader", path).exec_module(module)
    return module


def main():
    """Read the files that standard input names."""
    request = json.load(sys.stdin)
    out = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # libraries like to talk
    reader = load(request["reader"])
    reader.start()
    limits = set_memory_limit(used_addresses() + request["memory_bytes"])
    for path, cpu_s, most_bytes in request["files"]:
        if limits is not None:
            set_time_limit(limits, cpu_s)
        read(path, out, most_bytes, reader)
    os._exit(0)


if __name__ == "__main__":
    main()
