# Functions for the other scripts of this folder. The scripts install the files of $DIST, and run
# the first job of the README with few pixels. CLEAN is set on a machine that is used for this test
# only; on it a script may install packages of the system.
set -eu
: "${DIST:?must name the folder target/dist}"
HERE=$(cd "$(dirname "$0")" && pwd)
WORK=$(mktemp -d)
trap 'rm -rf "$WORK"' EXIT
cd "$WORK"

# one PATTERN: prints the path of the only file in $DIST that matches a pattern
one() {
    # shellcheck disable=SC2086
    set -- "$DIST"/$1
    [ -f "$1" ] || { echo "$DIST has no $1" >&2; exit 1; }
    [ $# -eq 1 ] || { echo "$DIST has several: $*" >&2; exit 1; }
    echo "$1"
}

# documented FILE: fails if README.md does not name this file of a release. README.md has the names
# of the files for x86_64, so the check is skipped on other machines.
documented() {
    [ "$(uname -m)" != x86_64 ] || grep -qF "${1##*/}" "$HERE/../../README.md" || { echo "README.md does not name ${1##*/}" >&2; exit 1; }
}

# packages NAME...: on a clean machine, installs packages of the system that users normally have
packages() {
    if [ -n "${CLEAN:-}" ]; then
        apt-get update -qq
        DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "$@" >packages.log || { cat packages.log; exit 1; }
    fi
}

# installs COMMAND...: runs a command that installs a file, and prints its time
installs() {
    start=$(date +%s.%N)
    "$@"
    echo "installed in $(echo "$start $(date +%s.%N)" | awk '{ printf "%.1f", $2 - $1 }') s: $*"
}

no_rust() {
    if command -v cargo >/dev/null; then echo "cargo is on PATH, but this test needs a machine without Rust" >&2; exit 1; fi
}

# unpacks the tarball into ~/.local; tests of the wheel and of the npm package use its scenes, too
tarball() {
    mkdir -p "$HOME/.local"
    file=$(one "lumistack-*-$(uname -m)-unknown-linux-gnu.tar.gz")
    documented "$file"
    installs tar xzf "$file" -C "$HOME/.local" --strip-components=1
}

# first_job PROGRAM SCENES: runs the first job of the README with few pixels, and checks its files
first_job() {
    "$1" --version
    "$1" doctor
    small "$@"
    for file in report.html layers/stack.json outputs/tensor-display/preview/preview.html; do
        [ -s "$WORK/run/$file" ] || { echo "the run left no $file" >&2; exit 1; }
    done
    "$1" simulate "$WORK/run" --view 4,-2 -o "$WORK/view.png"
    [ -s "$WORK/view.png" ]
    # a second run reuses all results
    small "$@" | grep PSNR
}

# small PROGRAM SCENES [FOLDER]: runs the job of the still life with few pixels, views and iterations;
# SMALL is another number of pixels
small() {
    "$1" run "$2/still-life/job.toml" --resolution "${SMALL:-96x60}" --views 3x3 --iterations 4 -o "${3:-$WORK/run}"
}

# same_quality RUN OTHER: fails if the PSNR of two runs over the viewing zone differs by more than
# 0.01 dB
same_quality() {
    echo "$(zone_psnr "$1") $(zone_psnr "$2")" | awk '
        { difference = $1 - $2; if (difference < 0) difference = -difference }
        { print "PSNR over the viewing zone: " $1 " dB, natively " $2 " dB" }
        END { exit !(NF == 2 && $1 > 0 && difference <= 0.01) }'
}

zone_psnr() { sed -n 's/.*"psnr_zone": *\([0-9.]*\).*/\1/p' "$1/report.json" | head -n 1; }
