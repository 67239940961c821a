# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""
Our tools as `python -m` runs them, each run a process of its own that need not import them again.

A server imports each once; each run is a fork of it. Importing costs ten times what most runs do.
That a tool starts from nothing is for test_cli.py, test_packaging.py and the tests with Program.
"""
import atexit
from functools import cache
import gc
import importlib
import json
import os
from pathlib import Path
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading

ROOT = Path(__file__).parents[1]
AT_START = ('PYTHON', 'LC_', 'LANG')       # what only a new interpreter reads
REQUEST_BYTES = 1 << 17


class _Server:
    """A process that imports tools; it ends when its socket is closed."""

    def __init__(self):
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno())], pass_fds=[theirs.fileno()],
                cwd=ROOT, stdin=subprocess.DEVNULL)
        atexit.register(self.end)

    def end(self):
        self._requests.close()
        self._process.wait()

    def fork(self, request, descriptors):
        socket.send_fds(self._requests, [json.dumps(request).encode()], descriptors)


_server = cache(_Server)


def end():
    """End the server, if there is one: what it used of the processor then counts as ours."""
    if _server.cache_info().currsize:
        _server().end()


def run(module, *arguments, stdin=None, stdout=None, cwd=ROOT, env=None, timeout=60):
    """
    Run a module of ours with these arguments; return what subprocess.run() does, in bytes.

    stdin, stdout: open files or descriptors; without them, nothing to read, and a pipe. env: all
    of its environment.
    """
    env = dict(os.environ) if env is None else {**env}
    changed = {name for name, _ in env.items() ^ os.environ.items() if name.startswith(AT_START)}
    assert not changed, f'{changed}: use a new interpreter'
    words = [os.fsencode(word).decode(errors='surrogateescape') for word in arguments]
    out, err, report = os.pipe(), os.pipe(), os.pipe()
    with open(os.devnull) as nothing:
        ends = [nothing if stdin is None else stdin, out[1] if stdout is None else stdout, err[1],
                report[1]]
        _server().fork([module, words, os.fspath(cwd), env], [
            one if isinstance(one, int) else one.fileno() for one in ends])
    for _, theirs in (out, err, report):
        os.close(theirs)
    texts = {}
    readers = [threading.Thread(target=_read, args=(one[0], texts, name))
               for name, one in (('out', out), ('err', err))]
    for reader in readers:
        reader.start()
    with open(report[0], 'rb', buffering=0) as told:
        pid = int(told.readline())
        if not (ended := select.select([told], [], [], timeout)[0]):
            os.kill(pid, signal.SIGKILL)
        code = int(told.readline())
    for reader in readers:
        reader.join()
    if not ended:
        raise subprocess.TimeoutExpired([module, *words], timeout, texts['out'], texts['err'])
    return subprocess.CompletedProcess([module, *words], code, texts['out'], texts['err'])


def run_text(module, *arguments, **options):
    done = run(module, *arguments, **options)
    done.stdout, done.stderr = done.stdout.decode(), done.stderr.decode()
    return done


def _read(descriptor, texts, name):
    with open(descriptor, 'rb') as file:
        texts[name] = file.read()


def _serve(requests):
    """Fork for each request, and report each end. Returns in a fork: what to run there."""
    running = {}
    ended, wakes = os.pipe()
    os.set_blocking(wakes, False)
    signal.set_wakeup_fd(wakes)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    while True:
        ready, _, _ = select.select([requests, ended], [], [])
        if ended in ready:
            os.read(ended, 4096)
            for pid, report in list(running.items()):
                done, status = os.waitpid(pid, os.WNOHANG)
                if done:
                    os.write(report, b'%d\n' % os.waitstatus_to_exitcode(status))
                    os.close(report)
                    del running[pid]
        if requests in ready:
            request, descriptors, *_ = socket.recv_fds(requests, REQUEST_BYTES, 4)
            if not request:
                sys.exit()
            words = json.loads(request)
            importlib.import_module(words[0])
            gc.freeze()                    # else each fork tidies up all of it at its end
            if not (pid := os.fork()):
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                requests.detach()
                return words, descriptors[:3]
            os.write(descriptors[3], b'%d\n' % pid)
            running[pid] = descriptors.pop()
            for descriptor in descriptors:
                os.close(descriptor)


def _become(arguments, folder, environment, descriptors):
    """Make this process what a new interpreter with these arguments is."""
    for number, descriptor in enumerate(descriptors):
        os.dup2(descriptor, number)
    os.closerange(3, max(descriptors) + 100)
    for name, number, mode in (('stdin', 0, 'r'), ('stdout', 1, 'w'), ('stderr', 2, 'w')):
        old = getattr(sys, name)
        file = open(number, mode, encoding=old.encoding, errors=old.errors, closefd=False,  # noqa: SIM115
                    buffering=1 if mode == 'w' and (number == 2 or os.isatty(number)) else -1)
        setattr(sys, name, file)
        setattr(sys, f'__{name}__', file)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.path[0] = folder
    sys.argv[1:] = arguments


if __name__ == '__main__':
    sys.path[0] = os.getcwd()
    (name, words, folder, environment), ends = _serve(socket.socket(fileno=int(sys.argv[1])))
    _become(words, folder, environment, ends)
    del sys.modules[name]
    runpy._run_module_as_main(name)
