"""Cache of compiled code whose files are verified before they are used.

numba's own cache trusts its files. A file truncated by a power failure makes every call of the function fail, in every
process, and a flipped bit is executed. This cache has one file per argument signature, and each file begins with the
hash of the rest. Code whose hash does not match is compiled again; code that cannot be written is used without being
cached; each warns once. Files are written atomically and there is no index, so concurrent writers do not disturb each
other. A process that needs code which another one is compiling waits for it. A directory that other users may write to
is refused, because its files are executed.

`remembering` keeps answers that numba looks for again and again. For every call, `a + b` and `x[i]` among them, numba
tries all implementations that are registered, from the most special one on, and writes an error message for each that
does not suit. For every variable, LLVM parses a module that numba writes to learn the size of its type. The same
operations on the same types recur in every function, so the answers are kept while one function and its callees are
compiled: the controller compiles in three quarters of the time.
"""

import gc
import os
import pickle
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from time import monotonic, sleep, time
from types import FunctionType
from typing import Any, TypeVar

import numba
from numba.core.base import BaseContext
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.serialize import dumps
from numba.core.targetconfig import ConfigStack, TargetConfig
from numba.core.types.functions import BaseFunction

from allocator.compilation import beside
from allocator.errors import CacheFault, notice_once
from allocator.files.atomic import replacing

Method = Callable[..., Any]


@contextmanager
def remembering() -> Iterator[None]:
    """Keep the answers of numba's questions; the caller holds numba's lock of compilation."""
    with (
        _replaced(BaseFunction, "get_call_type", _recalling),
        _replaced(BaseContext, "get_abi_sizeof", _measuring),
        _replaced(TargetConfig, "values", lambda _: _options),
    ):
        yield


@contextmanager
def _replaced(owner: type, name: str, replacement: Callable[[Method], Method]) -> Iterator[None]:
    """Replace a method by the `replacement` of it."""
    before = getattr(owner, name)
    setattr(owner, name, replacement(before))
    try:
        yield
    finally:
        setattr(owner, name, before)


def _recalling(resolve: Method) -> Method:
    """Return numba's resolution of calls, which asks `resolve` once for each call and types."""
    known: dict[Any, tuple[Any, Any]] = {}

    def recalled(self: Any, context: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call, as numba does."""
        key = context, self.typing_key, self.templates, tuple(args), tuple(kws.items()), ConfigStack.top_or_none()
        if key in known:
            signature, implementation = known[key]
            self._impl_keys[signature.args] = implementation
        else:
            signature = resolve(self, context, args, kws)
            known[key] = signature, self._impl_keys[signature.args]
        return signature

    return recalled


def _measuring(measure: Method) -> Method:
    """Return numba's size of a type of LLVM, which calls `measure` once for each type."""
    known: dict[str, int] = {}

    def measured(self: Any, kind: Any) -> int:
        """Return the size [bytes]; equal types have equal texts."""
        text = str(kind)
        if text not in known:
            known[text] = measure(self, kind)
        return known[text]

    return measured


def _options(self: Any) -> dict[str, Any]:
    """Return the options of a `TargetConfig`, which are compared for every call, without a property for each."""
    kind: Any = type(self)
    return {**_defaults(kind), **self._values}


@cache
def _defaults(config: Any) -> dict[str, Any]:
    return {name: option.default for name, option in config.options.items()}


F = TypeVar("F")
_HASH = 32  # bytes of SHA-256
_DAY = 86400.0  # [s]
_UNUSED = 7 * _DAY  # [s] without use, after which files of other versions are removed
_PATIENCE, _LOOK = 120.0, 0.05  # [s] to wait for another process, which may be suspended, and between two looks


class Refused(OSError):
    """A directory was refused, because others may write to it."""


def clear_stale(directory: Path, ours: str, current: str) -> None:
    """Remove the files of other versions from `directory` that have not been used for a week.

    All names begin with `ours`, those of this version with `current`. A week allows for two environments in turns.
    """
    families: dict[str, list[Path]] = {}
    for folder in (directory, directory / "__pycache__"):
        for file in [*folder.glob(f"{ours}*"), *folder.glob(f".{ours}*")]:  # the latter: interrupted drafts
            stem = file.name if file.name.startswith(".") else file.name.partition(".")[0]
            families.setdefault(stem, []).append(file)
    for stem, files in families.items():
        with suppress(OSError):  # already removed, or no permission
            if not stem.startswith(current) and max(f.stat().st_mtime for f in files) < time() - _UNUSED:
                for file in files:
                    file.unlink()


def keep(dispatcher: F, callees: Iterable[Callable[..., object]] = ()) -> F:
    """Return the numba `dispatcher`, which now caches the code that it compiles.

    Cached code is valid only for the present contents of its file, of the files of the `callees` that are compiled into
    it, and of the module-level numbers that they read. Raises `OSError` if there is no cache directory.
    """
    made: Any = dispatcher
    functions = made.py_func, *callees
    others = {function.__code__.co_filename for function in functions} - {made.py_func.__code__.co_filename}
    try:
        cache = _Cache(made.py_func, tuple(sorted(others)), _numbers(functions))
    except RuntimeError as error:
        if "cannot cache function" not in str(error):
            raise
        raise OSError(f"numba finds no directory to keep {made.py_func.__name__} in") from None
    compile_it = made.compile

    def compile_alone(signature: object) -> object:
        """Compile for a signature, unless another process does."""
        with global_compiler_lock, _without_collection(), remembering(), cache.alone():
            return compile_it(signature)

    made._cache, made.compile = cache, compile_alone
    return dispatcher


@contextmanager
def _without_collection() -> Iterator[None]:
    """Suspend garbage collection: compilation makes many objects and little garbage."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def check_own(directory: Path) -> None:
    """Raise `Refused` if another user can write to `directory`.

    A group with the owner's number counts as private, as Linux distributions create them.
    """
    if not hasattr(os, "geteuid"):
        return  # Windows: user directories are private
    found = directory.stat()
    if found.st_uid not in (os.geteuid(), 0):
        raise Refused(
            f"{directory} belongs to another user, and cached code is executed: "
            "set XDG_CACHE_HOME, and NUMBA_CACHE_DIR if there is one, to a directory of your own"
        )
    others = found.st_mode & stat.S_IWOTH or (found.st_mode & stat.S_IWGRP and found.st_gid != found.st_uid)
    if others:
        raise Refused(
            f"others may write to {directory}, and cached code is executed: "
            f"check its contents, then chmod go-w {directory}"
        )


def _numbers(functions: Iterable[Callable[..., object]]) -> list[tuple[str, str]]:
    """Return by name the global numbers that functions read, imported ones included."""
    named = ((name, f.__globals__.get(name)) for f in functions for name in f.__code__.co_names)
    return sorted({(name, repr(value)) for name, value in named if isinstance(value, int | float)})


class _Files:
    """Files of one function's cache, in place of `numba.core.caching.IndexDataCacheFile`."""

    def __init__(self, directory: str, name: str, stamp: object) -> None:
        self._directory, self._name, self._made_from = Path(directory), name, repr((numba.__version__, stamp))

    def load(self, key: object) -> object:
        """Return the cached object of `key`, or None."""
        file = self._file(key)
        try:
            content, used = file.read_bytes(), file.stat().st_mtime
        except FileNotFoundError:
            return None
        if content[:_HASH] != sha256(content[_HASH:]).digest():
            raise ValueError("not what was written")
        if used < time() - _DAY:
            with suppress(OSError):  # a read-only directory
                os.utime(file)  # mark as used, for `clear_stale`
        return pickle.loads(content[_HASH:])

    def save(self, key: object, data: object) -> None:
        """Cache `data`."""
        content = dumps(data)
        with replacing(self._file(key)) as draft:
            draft.write_bytes(sha256(content).digest() + content)

    @contextmanager
    def claimed(self, key: object) -> Iterator[None]:
        """Wait while another process compiles for `key`, and let others wait."""
        lock = self._file(key).with_suffix(".lock")
        try:
            file = lock.open("ab")
        except OSError:  # a read-only directory: everybody compiles
            yield
            return
        try:
            with file:
                end = monotonic() + _PATIENCE
                while not beside.locked(file) and monotonic() < end:
                    sleep(_LOOK)
                yield
        finally:
            with suppress(OSError):  # removed, or open in another process of Windows
                lock.unlink()

    def _file(self, key: object) -> Path:
        which = sha256(f"{self._made_from} {key!r}".encode()).hexdigest()[:24]
        return self._directory / f"{self._name}.{which}.kept"


class _Cache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """numba's cache on verified files."""

    def __init__(self, function: FunctionType, others: tuple[str, ...], numbers: list[tuple[str, str]]) -> None:
        super().__init__(function)
        if Path(self.cache_path) != Path(function.__code__.co_filename).parent / "__pycache__":  # as safe as the source
            check_own(Path(self.cache_path))
        locator = self._impl.locator
        stamps = [locator.get_source_stamp(), *((s.st_mtime, s.st_size) for s in map(os.stat, others)), numbers]
        self._cache_file = _Files(self.cache_path, self._impl.filename_base, stamps)
        self._claims = ExitStack()

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Hold what `load_overload` claims until the end of a compilation."""
        with ExitStack() as claims:
            before, self._claims = self._claims, claims
            try:
                yield
            finally:
                self._claims = before

    def load_overload(self, sig: object, target_context: Any) -> object:
        """Return the cached code for arguments of the types `sig`, or None if there is none or it is damaged.

        Raises `beside.NotKept` instead of returning None if compilation is forbidden.
        """
        found = self._loaded(sig, target_context)
        if found is None:
            beside.check_may_compile(self._name)
            key = self._index_key(sig, target_context.codegen())
            self._claims.enter_context(self._cache_file.claimed(key))
            found = self._loaded(sig, target_context)  # another process may have compiled it since the first look
        return found

    def _loaded(self, sig: object, target_context: object) -> object:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a damaged file can raise anything
            notice_once(f"compiled code in {self.cache_path} is damaged and is made anew", CacheFault)
        return None

    def save_overload(self, sig: object, data: object) -> None:
        """Cache `data` if possible; warn otherwise."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
            why = cause.strerror or str(cause)
            said = f"compiled code cannot be kept in {self.cache_path} ({why}): every new process compiles it again"
            notice_once(said, CacheFault)
