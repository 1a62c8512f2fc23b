"""Run a command where it sees no other process and can write to nothing but what it is given (Linux).

Run as a program, by a bare interpreter: ``python -I -S namespaces.py COMMAND...``. The variable ``RELOCBENCH_SANDBOX``,
which the command does not get, is a JSON object with ``parent``, the process id of who starts it, ``writable``, the
folders that the command may write to, and ``hidden``, the folders that it finds empty. No privileges are needed, only a
kernel that lets users make user namespaces (user_namespaces(7), mount_namespaces(7), pid_namespaces(7)):

- this process makes the namespaces, with a session keyring of their own, and waits; the kernel ends it with its parent;
- its child is process 1 of the new process namespace: it lays out what is seen, and the kernel ends all others with it;
- the command runs in a user namespace below that one, so that the kernel lets it undo nothing of this, and in a
  session of its own, so that signals to its process group reach nobody else.

The exit status is the command's, or 128 and the number of the signal that ended it.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

_NEWNS, _NEWIPC, _NEWUSER, _NEWPID = 0x00020000, 0x08000000, 0x10000000, 0x20000000
_MS_RDONLY, _MS_NOSUID, _MS_NODEV, _MS_BIND, _MS_REC, _MS_PRIVATE = 0x1, 0x2, 0x4, 0x1000, 0x4000, 0x40000
_PR_SET_PDEATHSIG, _PR_SET_NO_NEW_PRIVS = 1, 38
_SYS_MOUNT_SETATTR, _AT_FDCWD, _AT_RECURSIVE, _ATTR_RDONLY = 442, -100, 0x8000, 0x1
_SYS_KEYCTL, _KEYCTL_JOIN_SESSION_KEYRING = {"x86_64": 250, "aarch64": 219}, 1
OF_THE_SYSTEM = ("sys", "sysrq-trigger", "irq", "bus", "fs", "acpi", "scsi", "driver")
"""what in ``/proc`` is no process and can be written to by root, also by root in a namespace"""
SPEC = "RELOCBENCH_SANDBOX"
SIGNALLED = 128
"""what is added to the number of a signal that ended the command"""

_libc = ctypes.CDLL(None, use_errno=True)


class _MountAttributes(ctypes.Structure):
    """``struct mount_attr`` of mount_setattr(2)."""

    _fields_ = tuple((name, ctypes.c_uint64) for name in ("set", "clear", "propagation", "user_namespace"))


def main(*command: str) -> NoReturn:
    """Run a command. Raises OSError where the kernel does not allow it."""
    given = json.loads(os.environ.pop(SPEC))
    _end_with_parent()
    if os.getppid() != given["parent"]:
        os._exit(1)
    _own_namespaces(_NEWUSER | _NEWNS | _NEWPID | _NEWIPC)
    keyctl = _SYS_KEYCTL.get(os.uname().machine)
    if keyctl is not None:  # where it is forbidden, no process keeps notes in keys
        _libc.syscall(keyctl, _KEYCTL_JOIN_SESSION_KEYRING, None)
    first = os.fork()
    if not first:
        _end_with_parent()
        _lay_out(given["writable"], given["hidden"])
        started = os.fork()
        if not started:
            _own_namespaces(_NEWUSER)
            _check(_libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), "prctl")
            os.setsid()
            os.execvp(command[0], command)
        first = started
    _exit_as(first)


def _own_namespaces(kinds: int) -> None:
    """Enter new namespaces, in which this process remains the user that it is."""
    user, group = os.geteuid(), os.getegid()
    _check(_libc.unshare(kinds), "unshare")
    for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
        Path(f"/proc/self/{name}").write_text(text)


def _lay_out(writable: Sequence[str], hidden: Sequence[str]) -> None:
    """Make everything read-only but a few folders, and others empty, for the processes of this mount namespace."""
    _mount(None, "/", None, _MS_REC | _MS_PRIVATE)
    _mount("tmpfs", "/dev/shm", "tmpfs", _MS_NOSUID | _MS_NODEV)
    with suppress(OSError):  # a container that hides parts of its own /proc: its processes are then still seen
        _mount("proc", "/proc", "proc", _MS_NOSUID | _MS_NODEV)
    for path in writable:
        _mount(path, path, None, _MS_BIND | _MS_REC)
    _set_read_only("/", True)
    for path in (*writable, "/dev/shm", "/proc"):
        _allow_writing(path)
    for name in OF_THE_SYSTEM:
        with suppress(OSError):  # this system has none, or has it read-only
            _mount(f"/proc/{name}", f"/proc/{name}", None, _MS_BIND | _MS_REC)
            _set_read_only(f"/proc/{name}", True)
    for path in block_devices():
        _mount("/dev/null", path, None, _MS_BIND)
    here = Path.cwd()
    for path in hidden:
        _hide(path, [each for each in writable if Path(path) in Path(each).parents])
    os.chdir(here)  # by its name: what was mounted over it is entered


def block_devices() -> list[str]:
    """Disks as files, which root and some groups can read and write whatever is mounted."""
    return [
        str(path) for folder in ("/dev", "/dev/mapper") for path in Path(folder).glob("*") if path.is_block_device()
    ]


def _hide(path: str, shown: Sequence[str]) -> None:
    """Make a folder empty but for some folders below it."""
    opened = {each: os.open(each, os.O_PATH | os.O_DIRECTORY) for each in shown}
    _mount("tmpfs", path, "tmpfs", _MS_NOSUID | _MS_NODEV)
    for each, descriptor in opened.items():
        Path(each).mkdir(parents=True, exist_ok=True)
        _mount(f"/proc/self/fd/{descriptor}", each, None, _MS_BIND | _MS_REC)
        os.close(descriptor)
    _set_read_only(path, True, recursive=False)


def _allow_writing(path: str) -> None:
    """Undo that a folder is read-only, unless it was so before: the kernel does not let go of that."""
    for recursive in (True, False):
        with suppress(PermissionError):
            _set_read_only(path, False, recursive=recursive)
            break


def _mount(source: str | None, target: str, kind: str | None, flags: int) -> None:
    words = [None if word is None else os.fsencode(word) for word in (source, target, kind)]
    _check(_libc.mount(*words, ctypes.c_ulong(flags), None), target)


def _set_read_only(path: str, read_only: bool, *, recursive: bool = True) -> None:
    flag = (_ATTR_RDONLY, 0) if read_only else (0, _ATTR_RDONLY)
    attributes = _MountAttributes(*flag)
    size = ctypes.c_size_t(ctypes.sizeof(attributes))
    flags = _AT_RECURSIVE if recursive else 0
    call = _SYS_MOUNT_SETATTR, _AT_FDCWD, os.fsencode(path), flags, ctypes.byref(attributes), size
    _check(_libc.syscall(*call), path)


def _check(result: int, what: str) -> None:
    if result:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code), what)


def _end_with_parent() -> None:
    _check(_libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0), "prctl")


def _exit_as(pid: int) -> NoReturn:
    """Wait for a child, and for all whose parents have ended, and end as it did."""
    while True:
        ended, status = os.wait()
        if ended == pid:
            code = os.waitstatus_to_exitcode(status)
            os._exit(SIGNALLED - code if code < 0 else code)


if __name__ == "__main__":
    main(*sys.argv[1:])
