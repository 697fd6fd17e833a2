#!/bin/sh
# Runs the first job of the README with the program for ARM in qemu, and the wheel for ARM in
# Debian's Python for ARM. Compares the job's quality with the quality that the program for this
# machine gives. The job has a ninth of the pixels of the other tests, since qemu takes some forty
# times as long as this machine's processor.
SMALL=32x20
. "$(dirname "$0")/common.sh"
packages qemu-user mmdebstrap python3-venv
other=$(one "lumistack-*-aarch64-unknown-linux-gnu.tar.gz")
wheel=$(one "lumistack-*-abi3-manylinux*_aarch64.whl")
tarball
mkdir other
installs tar xzf "$other" -C other --strip-components=1
# unpack the system for ARM: its C library, Python and NumPy; BLAS has folders of its own
site=$(apt-get indextargets --format '$(SITE)' | grep -v security | head -n 1)
apt-config dump | grep '^Acquire::' >acquire.conf
mmdebstrap --quiet --variant=extract --architectures=arm64 --include=base-files,libgcc-s1,python3,python3-numpy \
    --aptopt="$WORK/acquire.conf" stable arm-debian "deb $site stable main"
blas=/usr/lib/aarch64-linux-gnu
for name in lumistack python; do
    case $name in lumistack) program=$WORK/other/bin/lumistack ;; *) program=$WORK/arm-debian/usr/bin/python3 ;; esac
    cat >"arm-$name" <<SCRIPT
#!/bin/sh
exec qemu-aarch64 -L "$WORK/arm-debian" -E LD_LIBRARY_PATH=$blas/blas:$blas/lapack "$program" "\$@"
SCRIPT
    chmod +x "arm-$name"
done
first_job ./arm-lumistack "$HOME/.local/share/lumistack/scenes"
small "$HOME/.local/bin/lumistack" "$HOME/.local/share/lumistack/scenes" "$WORK/native"
same_quality run native

# pip refuses a wheel whose tags do not match this Python
version=$(./arm-python -c 'import sys; print("%d.%d" % sys.version_info[:2])')
python3 -m venv venv
installs venv/bin/pip install --quiet --no-index --no-deps --target packages --only-binary=:all: \
    --platform manylinux_2_17_aarch64 --python-version "$version" "$wheel"
PYTHONPATH="$WORK/packages" ./arm-python "$HERE/wheel.py" "$WORK/run"
