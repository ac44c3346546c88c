#!/bin/sh
# Puts the rules, limits and services' settings of this folder where the system looks for them.
#
#   ./install.sh                 says what it would do, and does nothing
#   sudo ./install.sh --apply    does it; what is there already stays untouched, so it may be run again
#   sudo ./install.sh --remove   takes away what is there from here
#
# --user NAME    who shall use the devices (default: who called sudo)
# --gnss         also the settings of chrony and gpsd: for hosts with a GNSS receiver
# --root DIR     into DIR instead of /, without telling the system: for images, and for looking first
#
# Files that somebody has changed are kept beside as *.before-lsfb.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
mode=show root= user=${SUDO_USER:-} gnss=no
while [ $# -gt 0 ]; do
  case $1 in
    --apply) mode=apply ;;
    --remove) mode=remove ;;
    --gnss) gnss=yes ;;
    --user) shift; user=${1:?--user needs a name} ;;
    --root) shift; root=${1:?--root needs a folder} ;;
    -h | --help) sed -n '2,/^set/{/^set/d;s/^# \{0,1\}//;p;}' "$0"; exit 0 ;;
    *) echo "install.sh: unknown option $1; try --help" >&2; exit 2 ;;
  esac
  shift
done
if [ "$mode" != show ] && [ -z "$root" ] && [ "$(id -u)" -ne 0 ]; then
  echo "install.sh: --$mode changes system files: call it with sudo" >&2
  exit 1
fi
changed=no

# put FILE TARGET: copies one file where it differs.
put() {
  from=$here/$1 to=$root$2
  if [ "$mode" = remove ]; then
    [ -e "$to" ] || { echo "absent   $to"; return 0; }
    if cmp -s "$from" "$to"; then
      rm "$to"
      echo "removed  $to"
      if [ -e "$to.before-lsfb" ]; then
        mv "$to.before-lsfb" "$to"
        echo "restored $to"
      fi
      changed=yes
    else
      echo "kept     $to: not as it is here"
    fi
  elif cmp -s "$from" "$to"; then
    echo "same     $to"
  elif [ "$mode" = show ]; then
    if [ -e "$to" ]; then
      echo "would replace $to:"
      diff -u "$to" "$from" | sed '1,2d; s/^/    /' || true
    else
      echo "would write   $to"
    fi
  else
    mkdir -p "$(dirname "$to")"
    if [ -e "$to" ]; then
      cp -p "$to" "$to.before-lsfb"
      echo "replaced $to (before: $to.before-lsfb)"
    else
      echo "wrote    $to"
    fi
    cp "$from" "$to"
    chmod 644 "$to"
    changed=yes
  fi
}

# run WORDS: a command for the running system.
run() {
  if [ "$mode" = show ] || [ -n "$root" ]; then
    echo "would run     $*"
  else
    echo "running  $*"
    "$@" || echo "install.sh: that failed; the rest goes on" >&2
  fi
}

for rules in "$here"/70-lsfb-*.rules; do
  put "$(basename "$rules")" "/etc/udev/rules.d/$(basename "$rules")"
done
put 60-lsfb.conf /etc/sysctl.d/60-lsfb.conf
put lsfb-limits.conf /etc/security/limits.d/60-lsfb.conf
put lsfb-tmpfiles.conf /etc/tmpfiles.d/lsfb.conf
put lsfb-modprobe.conf /etc/modprobe.d/lsfb.conf
put 80-lsfb-can.network /etc/systemd/network/80-lsfb-can.network
if [ "$gnss" = yes ] || [ "$mode" = remove ]; then
  put lsfb-chrony.conf /etc/chrony/conf.d/lsfb.conf
  put lsfb-gpsd /etc/default/gpsd
fi

if [ "$mode" != remove ]; then
  getent group lsfb >/dev/null || run groupadd --system lsfb
  if [ -z "$user" ] || [ "$user" = root ]; then
    echo "no user was named: add yours to the groups with --user NAME"
  else
    for group in lsfb video dialout plugdev; do
      # A group that the system does not have gives nothing.
      if [ "$group" != lsfb ] && ! getent group "$group" >/dev/null; then
        echo "no group $group on this system"
      elif id -nG "$user" 2>/dev/null | tr ' ' '\n' | grep -qx "$group"; then
        echo "same     $user is in $group"
      else
        run usermod -aG "$group" "$user"
        echo "         $user must log in again"
      fi
    done
  fi
fi

if [ "$changed" = yes ] || [ "$mode" = show ]; then
  run udevadm control --reload
  run udevadm trigger
  [ "$mode" = remove ] || run sysctl -p "$root/etc/sysctl.d/60-lsfb.conf"
  [ "$mode" = remove ] || run systemd-tmpfiles --create "$root/etc/tmpfiles.d/lsfb.conf"
  [ "$gnss" = no ] || run systemctl try-restart chrony gpsd
fi
[ "$mode" != show ] || echo "nothing was changed; sudo $0 --apply does it, and lsfb doctor --host checks it"
