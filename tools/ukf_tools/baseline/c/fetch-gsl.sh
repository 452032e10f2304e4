#!/bin/sh
# Gets the GNU Scientific Library for armhf from Debian, without touching the system's packages:
#   fetch-gsl.sh FOLDER
# puts usr/include/gsl and usr/lib/arm-linux-gnueabihf/libgsl.a into FOLDER.
set -eu
[ $# = 1 ] || { echo "usage: fetch-gsl.sh FOLDER" >&2; exit 2; }
mkdir -p "$1"
folder=$(cd "$1" && pwd)
apt=$folder/apt
mkdir -p "$apt/etc/apt" "$apt/var/lib/dpkg" "$apt/var/lib/apt/lists/partial" \
    "$apt/var/cache/apt/archives/partial" "$folder/packages"
cp -r /etc/apt/sources.list* /etc/apt/trusted.gpg.d "$apt/etc/apt/" 2>/dev/null || true
: >"$apt/var/lib/dpkg/status"
cat >"$apt/apt.conf" <<CONF
Dir "$apt";
Dir::State::status "$apt/var/lib/dpkg/status";
APT::Architecture "armhf";
APT::Architectures { "armhf"; };
APT::Sandbox::User "root";
CONF
export APT_CONFIG="$apt/apt.conf"
# One index that fails is no matter if it is not the one that is needed.
apt-get -q update || echo "Some indexes are missing" >&2
(cd "$folder/packages" && apt-get -q download libgsl-dev libgsl27 libgslcblas0)
for package in "$folder"/packages/*.deb; do
    dpkg -x "$package" "$folder"
done
rm -r "$apt" "$folder/packages"
