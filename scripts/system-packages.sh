#!/bin/sh
# Says in one line each which system packages are missing and how to get them, and installs them where it
# may (root on Debian or Ubuntu). Never fails: what is missing costs only the features that its line names.
#   system-packages.sh run    what the viewer needs
#   system-packages.sh test   that, and what the tests need
set -u
[ "$(uname -s)" = Linux ] || exit 0
PATH=$PATH:/sbin:/usr/sbin
what=${1:-run}

has_library() { ldconfig -p 2>/dev/null | grep -q "$1"; }
has_mesa() {
    for folder in /usr/lib/*/dri /usr/lib64/dri /usr/lib/dri; do
        [ -e "$folder/swrast_dri.so" ] && return 0
        [ -e "$folder/libdril_dri.so" ] && return 0
    done
    # A vendor's driver (NVIDIA's, say) does as well.
    has_library 'libEGL_nvidia\|libGLX_nvidia\|libgallium'
}

missing=""
need() { # need TEST-RESULT PACKAGE PURPOSE
    [ "$1" -eq 0 ] && return
    missing="$missing $2"
    echo "missing: $2 ($3); on Debian or Ubuntu: apt-get install $2"
}

has_library 'libEGL\.so\.1'; need $? libegl1 "pictures without a window"
has_library 'libGL\.so\.1'; need $? libgl1 "the window"
has_mesa; need $? libgl1-mesa-dri "OpenGL without a GPU's own driver"
for pair in X11.so.6:libx11-6 Xcursor:libxcursor1 Xi.so:libxi6 Xinerama:libxinerama1 Xrandr:libxrandr2; do
    has_library "lib${pair%%:*}"; need $? "${pair##*:}" "the window"
done
if [ "$what" = test ]; then
    command -v Xvfb >/dev/null; need $? xvfb "the tests that open a window"
    command -v glslangValidator >/dev/null; need $? glslang-tools "the test of shaders by a second compiler"
fi
[ -z "$missing" ] && exit 0

if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
    echo "installing:$missing"
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086
    { apt-get update -q && apt-get install -q -y --no-install-recommends $missing; } >/dev/null 2>&1 ||
        echo "that failed: run  apt-get update && apt-get install$missing  to see why"
fi
exit 0
