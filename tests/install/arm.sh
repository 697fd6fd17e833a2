#!/bin/sh
# Runs the first job of the README with the program for ARM in qemu. Compares the result's quality
# with the quality that the program for this machine gives. The job has a ninth of the pixels of the
# other tests, since qemu takes some forty times as long as this machine's processor.
SMALL=32x20
. "$(dirname "$0")/common.sh"
packages qemu-user libc6-arm64-cross libgcc-s1-arm64-cross
other=$(one "lumistack-*-aarch64-unknown-linux-gnu.tar.gz")
tarball
mkdir other
installs tar xzf "$other" -C other --strip-components=1
cat >arm <<SCRIPT
#!/bin/sh
exec qemu-aarch64 -L /usr/aarch64-linux-gnu "$WORK/other/bin/lumistack" "\$@"
SCRIPT
chmod +x arm
first_job ./arm "$HOME/.local/share/lumistack/scenes"
small "$HOME/.local/bin/lumistack" "$HOME/.local/share/lumistack/scenes" "$WORK/native"
same_quality run native
