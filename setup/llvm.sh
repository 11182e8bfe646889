#!/bin/sh
# Makes sure that a libLLVM is there on which Dr.Jit runs (19 or newer): by apt where it may, else
# stops with the command to type.
set -eu
python=$1
finds() { "$python" -c 'from twin.engine import ensure_llvm; ensure_llvm()' 2>/dev/null; }

finds && exit 0
if [ -n "${DRJIT_LIBLLVM_PATH:-}" ]; then
    exec "$python" -c 'from twin.engine import ensure_llvm, EngineError
try: ensure_llvm()
except EngineError as error: raise SystemExit(str(error))'
fi
if [ "$(id -u)" = 0 ]; then sudo=""; else sudo="sudo -n"; fi
if command -v apt-get >/dev/null && { [ -z "$sudo" ] || $sudo true 2>/dev/null; }; then
    echo "installing libllvm19"
    $sudo apt-get update -qq && $sudo apt-get install -y -qq libllvm19 >/dev/null
fi
finds && exit 0
echo "no libLLVM 19 or newer on this machine. Install one, then repeat:" >&2
echo "    sudo apt-get install libllvm19" >&2
exit 1
