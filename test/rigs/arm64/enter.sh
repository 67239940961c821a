#!/bin/sh
# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
# Run a command in a root folder for arm64. usage, in user and mount namespaces of its own
# (unshare --user --map-root-user --mount): enter.sh ROOT FOLDER COMMAND ...
# FOLDER is seen as /here, and the command runs in its src. Nothing of it is left when the command has ended.
set -eu
root=$1 folder=$2
shift 2
# Since Linux 6.7 a user namespace has programs of other processors for itself; before, the
# package qemu-user-static has told the whole machine.
formats=/proc/sys/fs/binfmt_misc
if [ ! -e $formats/qemu-aarch64 ]; then
    if ! mount -t binfmt_misc binfmt_misc $formats 2>/dev/null || [ ! -w $formats/register ]; then
        echo 'test-arm64: this kernel does not know programs for arm64;' \
            'sudo systemctl restart systemd-binfmt, or a kernel since 6.7' >&2
        exit 1
    fi
    # F: opened now, so that it is found in the root, too. Magic and mask: an ELF for arm64.
    magic='\x7f\x45\x4c\x46\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00'
    mask='\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff'
    printf '%s' ":qemu-aarch64:M::$magic:$mask:$(command -v qemu-aarch64-static):OF" \
        > $formats/register
fi
mount -t tmpfs -o mode=755 dev "$root/dev"
for name in null zero full random urandom tty; do
    : > "$root/dev/$name"
    mount --bind /dev/$name "$root/dev/$name"
done
mkdir "$root/dev/pts" "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666,mode=620 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx"
ln -s /proc/self/fd "$root/dev/fd"
for name in dev/shm tmp run; do
    mount -t tmpfs -o mode=1777 tmpfs "$root/$name"
done
mount --rbind /proc "$root/proc"
mount --rbind /sys "$root/sys"
mkdir -p "$root/here"
mount --bind "$folder" "$root/here"
exec chroot "$root" /usr/bin/env -i HOME=/root LANG=C.UTF-8 TERM="${TERM:-dumb}" \
    PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
    /bin/sh -c 'cd /here/src && exec "$@"' sh "$@"
