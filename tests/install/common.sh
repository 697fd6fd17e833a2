<<<<<<< HEAD
# Functions for the other scripts. They find files in $DIST, and run the first job in a small size.
# CLEAN is set if the whole machine belongs to the test.
=======
# Functions of the other scripts, which install the files of $DIST and run the first job in a small size. CLEAN is set on a
# machine that is used for this test only, so that a script may install packages of the system.
>>>>>>> h-w5
set -eu
: "${DIST:?must name the folder target/dist}"
HERE=$(cd "$(dirname "$0")" && pwd)
WORK=$(mktemp -d)
trap 'rm -rf "$WORK"' EXIT
cd "$WORK"

<<<<<<< HEAD
# prints the only file of target/dist that matches a pattern
=======
# prints the path of the only file in $DIST that matches a pattern
>>>>>>> h-w5
one() {
    # shellcheck disable=SC2086
    set -- "$DIST"/$1
    [ -f "$1" ] || { echo "$DIST has no $1" >&2; exit 1; }
    [ $# -eq 1 ] || { echo "$DIST has several: $*" >&2; exit 1; }
    echo "$1"
}

<<<<<<< HEAD
# installs programs that a user's system has already
=======
# installs the system's packages that a user is assumed to have
>>>>>>> h-w5
packages() {
    if [ -n "${CLEAN:-}" ]; then
        apt-get update -qq
        DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "$@" >packages.log || { cat packages.log; exit 1; }
    fi
}

<<<<<<< HEAD
# runs the command that installs, and prints its duration
=======
# runs an installing command and prints its time
>>>>>>> h-w5
installs() {
    start=$(date +%s.%N)
    "$@"
    echo "installed in $(echo "$start $(date +%s.%N)" | awk '{ printf "%.1f", $2 - $1 }') s: $*"
}

no_rust() {
    if command -v cargo >/dev/null; then echo "cargo is on PATH, but this test needs a machine without Rust" >&2; exit 1; fi
}

<<<<<<< HEAD
# unpacks the tarball; tests of other packages use its scenes
=======
# unpacks the tarball; tests of the wheel and of the npm package use its scenes
>>>>>>> h-w5
tarball() {
    mkdir -p "$HOME/.local"
    installs tar xzf "$(one "lumistack-*-$(uname -m)-unknown-linux-gnu.tar.gz")" -C "$HOME/.local" --strip-components=1
}

<<<<<<< HEAD
# runs the first job of README in a small size: first_job PROGRAM SCENES
=======
# first_job PROGRAM SCENES: runs README's first job in a small size, and checks its files
>>>>>>> h-w5
first_job() {
    "$1" --version
    "$1" doctor
    small "$@"
    for file in report.html layers/stack.json outputs/tensor-display/preview/preview.html; do
        [ -s "$WORK/run/$file" ] || { echo "the run left no $file" >&2; exit 1; }
    done
    "$1" simulate "$WORK/run" --view 4,-2 -o "$WORK/view.png"
    [ -s "$WORK/view.png" ]
<<<<<<< HEAD
    # a second run reuses all results
=======
    # again: now all results are in the cache
>>>>>>> h-w5
    small "$@" | grep PSNR
}

# small PROGRAM SCENES [FOLDER]: runs the job of the still life with few pixels, views and iterations
small() {
    "$1" run "$2/still-life/job.toml" --resolution 96x60 --views 3x3 --iterations 4 -o "${3:-$WORK/run}"
}
