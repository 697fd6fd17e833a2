#!/bin/sh
# Runs the first job of the README with the program for Windows in Wine, in a folder with a
# non-ASCII name and with few pixels. Compares the result's quality with the quality that the
# program for Linux gives. Then runs the job in a folder with a long path, and two runs in one
# folder. Rust's standard library needs bcryptprimitives.dll, which Wine 8 and older do not have.
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

scenes="$HOME/.local/share/lumistack/scenes"
mkdir 'Größe 日本'
first_job ./windows "$scenes"
mv run 'Größe 日本/run'
./windows simulate 'Größe 日本/run' --view 4,-2 -o 'Größe 日本/view.png'
[ -s 'Größe 日本/view.png' ]
small "$HOME/.local/bin/lumistack" "$scenes" "$WORK/linux"
same_quality 'Größe 日本/run' linux

# Most files of this run have paths longer than 260 characters, the limit of older functions of
# Windows. Wine resolves links (GetFinalPathNameByHandle) only in paths of at most 264 characters,
# so the path of layers/stack.json has 258.
deep=$(printf "%0$((258 - 21 - ${#WORK}))d" 0 | sed 's|\(.\{40\}\)0|\1/|g')
small ./windows "$scenes" "$deep"
./windows info "$deep"
./windows simulate "$deep" --view 4,-2 -o "$deep/view.png"
[ -s "$deep/view.png" ]
long=$(find "$WORK/$deep" -type f | awk 'length($0) + length("Z:") > 260' | wc -l)
[ "$long" -gt 100 ] || { echo "only $long files have long paths" >&2; exit 1; }
same_quality "$deep" linux

# a folder is refused while another run uses it, and free afterwards
./windows run "$scenes/still-life/job.toml" --resolution 192x120 --views 5x5 --iterations 4 -o busy >first.log 2>&1 &
first=$!
for _ in $(seq 300); do [ ! -s busy/cache/owner.json ] || break; sleep 0.1; done
if small ./windows "$scenes" busy >second.log 2>&1; then echo "two runs used one folder at the same time" >&2; exit 1; fi
grep "another run uses this folder" second.log
wait "$first" || { cat first.log; exit 1; }
small ./windows "$scenes" busy | grep PSNR
