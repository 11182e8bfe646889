"""The rendering engine: Mitsuba 3 on Dr.Jit, started only on an LLVM library that works.

Dr.Jit 1.5 aborts the whole process with libLLVM 14, 15 and 16 ("Cannot select fminimum"), and old
ones are common. So a good one is found first and named in ``DRJIT_LIBLLVM_PATH``; where there is
none, `EngineError` says so before Dr.Jit is loaded.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from hardware.interruption import signals_deferred
from twin.errors import EngineError

__all__ = [
    "OLDEST_LLVM",
    "EngineError",
    "check_scenes_of_a_kernel",
    "ensure_llvm",
    "exr_threads",
    "llvm_version",
    "mitsuba",
    "mitsuba_of_radar",
    "return_freed_memory",
    "sionna",
]

#: Tried and found good: 19. Newer ones are expected to work, 17 and 18 were never tried.
OLDEST_LLVM = 19
_WHERE = (
    "/usr/lib/*-linux-gnu/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
)
_EXR_THREADS = 2
_REMEDY = (
    f"install libLLVM {OLDEST_LLVM} or newer (Debian, Ubuntu: sudo apt-get install libllvm19) "
    "or name one in DRJIT_LIBLLVM_PATH"
)


def mitsuba() -> ModuleType:
    """Mitsuba on the processor, or in the variant that ``TWIN_VARIANT`` names (``llvm_ad_mono`` or
    ``cuda_ad_mono``).

    Never CUDA by itself, GPU or not: it computes the camera's light of what is at rest, and no more
    (`check_scenes_of_a_kernel`, `mitsuba_of_radar`). What was measured is in docs/howto/gpu.md.

    Raises EngineError where the variant can't be started.
    """
    return _with_variant(_variant())


def mitsuba_of_radar() -> ModuleType:
    """Mitsuba on the processor.

    On CUDA cross-sections of plates and spheres were off, by 0.4 to 6 dB and in phase, and the
    radar compiled for a minute and more. Raises EngineError where ``TWIN_VARIANT`` names it, else
    as `mitsuba`.
    """
    return _with_variant(_variant_of_radar())


def sionna() -> ModuleType:
    """Sionna RT, with Mitsuba set to the polarised variant that it needs.

    Both engines live in one process; `mitsuba` sets the other variant again, and what was made in
    each stays usable. Raises EngineError as `mitsuba_of_radar` does.
    """
    polarized = f"{_variant_of_radar()}_polarized"
    _with_variant(polarized)
    with signals_deferred():
        import sionna.rt as rt  # sets a variant of its own when first imported

    _with_variant(polarized)
    return rt


def _variant() -> str:
    name = os.environ.get("TWIN_VARIANT") or "llvm_ad_mono"
    if name not in ("llvm_ad_mono", "cuda_ad_mono"):
        raise EngineError(f"TWIN_VARIANT: {name!r} is none of llvm_ad_mono, cuda_ad_mono")
    return name


def _variant_of_radar() -> str:
    if _variant().startswith("cuda"):
        raise EngineError(
            "TWIN_VARIANT: cuda_ad_mono computes the camera's light alone; the radar is computed "
            "on the processor, without TWIN_VARIANT"
        )
    return _variant()


def check_scenes_of_a_kernel(n_scenes: int, what: str) -> None:
    """Raise EngineError where kernels that trace several scenes would be wrong.

    With OptiX, Dr.Jit 1.5 traces one scene in a kernel. Rays of the others hit nothing, of which
    it prints a warning.
    """
    if n_scenes > 1 and _variant().startswith("cuda"):
        raise EngineError(
            f"TWIN_VARIANT: cuda_ad_mono traces one scene in a kernel; {what}: "
            "without TWIN_VARIANT they are computed on the processor"
        )


def _with_variant(name: str) -> ModuleType:
    """Mitsuba in a variant; set only when it changes, which takes a moment."""
    loaded = sys.modules.get("mitsuba")
    if loaded is not None and loaded.variant() == name:
        return loaded
    try:
        Path.cwd()
    except OSError as error:  # Mitsuba would abort the process
        raise EngineError(f"the working directory is gone ({error.strerror})") from error
    if name.startswith("llvm"):
        ensure_llvm()
    with signals_deferred():  # an exception within registered code aborts the process
        import mitsuba as mi

        try:
            mi.set_variant(name)
        except ImportError as error:  # Dr.Jit's, where it finds no CUDA driver
            if not name.startswith("cuda"):
                raise
            raise EngineError(
                f"{name} can't be started: no CUDA driver that works; "
                "TWIN_VARIANT=llvm_ad_mono computes on the CPU"
            ) from error
        mi.set_log_level(mi.LogLevel.Error)
    return mi


def use_cores(share: float) -> None:
    """Have the engine use a share of this process's cores, at least one."""
    import drjit as dr

    dr.set_thread_count(max(1, round(share * len(os.sched_getaffinity(0)))))


def return_freed_memory() -> None:
    """Have Dr.Jit and the C library hand memory that was freed back to the system, where they can.

    Dr.Jit keeps arrays for later ones of the same size, and glibc what lies below anything that is
    still in use: after sixteen bursts of the radar 0.8 of 1.2 GB, and more after each.
    """
    import ctypes

    if "drjit" in sys.modules:
        import drjit as dr

        dr.flush_malloc_cache()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:
        trim(0)


@contextmanager
def exr_threads() -> Iterator[None]:
    """Threads that Mitsuba needs to read and write OpenEXR: it waits for tasks in Dr.Jit's pool,
    with a pool of one thread, as on a single core, forever.
    """
    import drjit as dr

    threads = dr.thread_count()
    if threads >= _EXR_THREADS:
        yield
        return
    dr.set_thread_count(_EXR_THREADS)
    try:
        yield
    finally:
        dr.set_thread_count(threads)


def ensure_llvm() -> Path:
    """Find a usable libLLVM and name it in ``DRJIT_LIBLLVM_PATH``.

    Raises EngineError when the one named there is unusable, or when none is found.
    """
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        path = Path(named)
        if not path.is_file():
            raise EngineError(f"DRJIT_LIBLLVM_PATH: {named}: no such file; {_REMEDY}")
        version = llvm_version(path)
        if version is None or version < OLDEST_LLVM:
            found = f"libLLVM {version}" if version else "no libLLVM that loads"
            raise EngineError(
                f"DRJIT_LIBLLVM_PATH: {named} is {found}, on which Dr.Jit aborts; {_REMEDY}"
            )
        return path
    found_versions = _installed()
    usable = {v: p for v, p in found_versions.items() if v >= OLDEST_LLVM}
    if not usable:
        have = ", ".join(str(v) for v in sorted(found_versions)) or "none"
        raise EngineError(f"no usable libLLVM (found: {have}); {_REMEDY}")
    path = usable[min(usable)]  # nearest to the one that was tried
    os.environ["DRJIT_LIBLLVM_PATH"] = str(path)
    return path


def llvm_version(path: Path) -> int | None:
    """Major version of a libLLVM, from its file name, else by asking it; None if it won't say.

    It is asked in a process of its own: two LLVMs in one process abort it.
    """
    name = re.fullmatch(r"libLLVM(?:[-.](?:so\.)?(\d+))?.*", Path(path).resolve().name)
    if name and name[1]:
        return int(name[1])
    ask = (
        "import ctypes, sys\n"
        "llvm = ctypes.CDLL(sys.argv[1])\n"
        "major = ctypes.c_uint()\n"
        "llvm.LLVMGetVersion(ctypes.byref(major), None, None)\n"
        "print(major.value)"
    )
    answer = subprocess.run(
        [sys.executable, "-c", ask, str(path)], capture_output=True, text=True, check=False
    )
    return int(answer.stdout) if answer.returncode == 0 else None


def _installed() -> dict[int, Path]:
    """Every libLLVM in the usual places, by major version."""
    found: dict[int, Path] = {}
    for pattern in _WHERE:
        for path in sorted(Path("/").glob(pattern[1:])):
            version = llvm_version(path)
            if version is not None:
                found.setdefault(version, path)
    return found
