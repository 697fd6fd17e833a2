# Functions for the other scripts. They find files in $DIST, and run the first job in a small size.
# CLEAN is set if the whole machine belongs to the test.
set -eu
: "${DIST:?names the folder target/dist}"
HERE=$(cd "$(dirname "$0")" && pwd)
WORK=$(mktemp -d)
trap 'rm -rf "$WORK"' EXIT
cd "$WORK"

# prints the only file of target/dist that matches a pattern
one() {
    # shellcheck disable=SC2086
    set -- "$DIST"/$1
    [ -f "$1" ] || { echo "$DIST has no $1" >&2; exit 1; }
    [ $# -eq 1 ] || { echo "$DIST has several: $*" >&2; exit 1; }
    echo "$1"
}

# installs programs that a user's system has already
packages() {
    if [ -n "${CLEAN:-}" ]; then
        apt-get update -qq
        DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "$@" >packages.log || { cat packages.log; exit 1; }
    fi
}

# runs the command that installs, and prints its duration
installs() {
    start=$(date +%s.%N)
    "$@"
    echo "installed in $(echo "$start $(date +%s.%N)" | awk '{ printf "%.1f", $2 - $1 }') s: $*"
}

no_rust() {
    if command -v cargo >/dev/null; then echo "cargo is on PATH: this is no clean machine" >&2; exit 1; fi
}

# unpacks the tarball; tests of other packages use its scenes
tarball() {
    mkdir -p "$HOME/.local"
    installs tar xzf "$(one "lumistack-*-$(uname -m)-unknown-linux-gnu.tar.gz")" -C "$HOME/.local" --strip-components=1
}

# runs the first job of README in a small size: first_job PROGRAM SCENES
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

# small PROGRAM SCENES [FOLDER]
small() {
    "$1" run "$2/still-life/job.toml" --resolution 96x60 --views 3x3 --iterations 4 -o "${3:-$WORK/run}"
}
