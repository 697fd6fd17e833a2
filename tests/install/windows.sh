#!/bin/sh
# Runs the first job of the README with the program for Windows in Wine, in a folder with a
# non-ASCII name and with few pixels. Compares the quality of the result with that of the program
# for Linux. Rust's standard library needs bcryptprimitives.dll, which Wine 8 and older do not have.
. "$(dirname "$0")/common.sh"
packages wine wine64 unzip xvfb
zip=$(one "lumistack-*-x86_64-pc-windows-gnu.zip")
tarball
installs unzip -q "$zip" -d unpacked
export WINEPREFIX="$WORK/wine" WINEDEBUG=-all,err+module WINEDLLOVERRIDES="mscoree=;mshtml="
# start a virtual screen: without a screen, winit's event loop waits for ever in Wine, so `lumistack
# doctor` would not end
Xvfb :93 >xvfb.log 2>&1 &
screen=$!
export DISPLAY=:93
trap 'wineboot --kill || true; kill $screen; rm -rf "$WORK"' EXIT
wineboot --init

cat >windows <<SCRIPT
#!/bin/sh
exec wine "$(echo "$WORK"/unpacked/*/bin/lumistack.exe)" "\$@"
SCRIPT
chmod +x windows

mkdir 'Größe 日本'
first_job ./windows "$HOME/.local/share/lumistack/scenes"
mv run 'Größe 日本/run'
./windows simulate 'Größe 日本/run' --view 4,-2 -o 'Größe 日本/view.png'
[ -s 'Größe 日本/view.png' ]
small "$HOME/.local/bin/lumistack" "$HOME/.local/share/lumistack/scenes" "$WORK/linux"
same_quality 'Größe 日本/run' linux
