#!/bin/sh
# The tarball for ARM, in qemu. Its first job must reach the quality of this machine's program.
. "$(dirname "$0")/common.sh"
no_rust
: "${CLEAN:?needs a Debian of its own, for libraries of another architecture}"
dpkg --add-architecture arm64
packages qemu-user libc6:arm64 libgcc-s1:arm64
tarball
scenes="$HOME/.local/share/lumistack/scenes"
mkdir arm
installs tar xzf "$(one "lumistack-*-aarch64-unknown-linux-gnu.tar.gz")" -C arm --strip-components=1
printf '#!/bin/sh\nexec qemu-aarch64 "%s" "$@"\n' "$WORK/arm/bin/lumistack" >lumistack
chmod +x lumistack
first_job ./lumistack "$scenes"
same_quality qemu "$scenes"
