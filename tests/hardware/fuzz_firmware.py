"""Coverage-guided fuzzing of the reference firmware: ``fuzz_firmware.py LIBRARY -runs=9 CORPUS``.

LIBRARY is `build`'s; further arguments are libFuzzer's. Inputs become bytes on the line as in
`fuzz_parser`: single frames, or whole conversations of requests with uploads of a table in them.
"""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

_COUNTERS = 16384
_CHECKED = ("-g", "-O1", "-fPIC", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def build(compiler: str, sources: Path, folder: Path) -> Path:
    """Firmware with every access checked and every edge counted, as a library."""
    command = [compiler, *_CHECKED, "-DMOST_TABLE_BYTES=256u", f"-I{sources}"]
    objects = []
    for name in ("device", "frame", "patterns", "fuzz_firmware"):
        own = name == "fuzz_firmware"
        source = (Path(__file__).parent if own else sources) / f"{name}.c"
        counted = () if own else ("-fsanitize-coverage=trace-pc",)
        objects.append(str(folder / f"{name}.o"))
        subprocess.run([*command, *counted, "-c", str(source), "-o", objects[-1]], check=True)
    library = folder / "fuzzed.so"
    link = [compiler, *_CHECKED, "-shared", "-o", str(library), *objects, "-lm"]
    subprocess.run(link, check=True)
    return library


def environment(compiler: str) -> dict[str, str]:
    """What a process needs that loads the library."""
    command = [compiler, "-print-file-name=libasan.so"]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    return {
        **os.environ,
        "LD_PRELOAD": found,
        "ASAN_OPTIONS": "detect_leaks=0:quarantine_size_mb=1",
    }


def main(library: str, arguments: list[str]) -> None:
    import atheris
    from atheris import core_with_libfuzzer
    from fuzz_parser import on_the_line, seeded

    device, fuzzer = ctypes.CDLL(library), ctypes.CDLL(core_with_libfuzzer.__file__)
    counters = (ctypes.c_uint8 * _COUNTERS).in_dll(device, "counters")
    start = ctypes.addressof(counters)
    # A place and its kind for each counter, which only reports would need.
    places = (ctypes.c_uint64 * (2 * _COUNTERS))(*(i // 2 for i in range(2 * _COUNTERS)))
    fuzzer.__getattr__("__sanitizer_cov_8bit_counters_init")(
        ctypes.c_void_p(start), ctypes.c_void_p(start + _COUNTERS)
    )
    fuzzer.__getattr__("__sanitizer_cov_pcs_init")(
        places, ctypes.c_void_p(ctypes.addressof(places) + ctypes.sizeof(places))
    )

    def one_input(data: bytes) -> None:
        if data:
            line = on_the_line(data)
            assert device.one_input(line, ctypes.c_size_t(len(line))) in range(4)

    atheris.Setup([sys.argv[0], *seeded(arguments)], one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
