#!/bin/sh
# Runs README's first job with the program for Windows in Wine, in a folder with a non-ASCII name.
# Compares its quality with that of the program for Linux. Both make a small size of the job.
. "$(dirname "$0")/common.sh"
packages wine wine64 unzip
zip=$(one "lumistack-*-x86_64-pc-windows-gnu.zip")
tarball
installs unzip -q "$zip" -d unpacked
export WINEPREFIX="$WORK/wine" WINEDEBUG=-all WINEDLLOVERRIDES="mscoree=;mshtml="
trap 'wineboot --kill || true; rm -rf "$WORK"' EXIT
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
