#!/bin/bash
# Boot systemd on this machine's system with everything emptied that a clean one has not, without network.
# $1: folder with dist/ (packages), io/ (what comes out) and the scripts; to be run by root in new namespaces.
set -e
work=$1
here=$(cd "$(dirname "$0")" && pwd)
mount --make-rprivate /
mkdir -p "$work/changes" "$work/root"
mount -t tmpfs -o size=9g changes "$work/changes"
mkdir "$work/changes/upper" "$work/changes/work"
root=$work/root
mount -t overlay -o "lowerdir=/,upperdir=$work/changes/upper,workdir=$work/changes/work" root "$root"
cp "$here/inside.sh" "$work/changes/inside.sh"
for folder in opt root work tmp run var/tmp usr/local mnt home srv; do
    mkdir -p "$root/$folder"
    mount -t tmpfs -o mode=1777 empty "$root/$folder"
done
mkdir -p "$root/run/lock" "$root/usr/local/bin"
rm -rf "$root/var/log/journal" "$root"/etc/systemd/system/multi-user.target.wants/*

mount -t proc proc "$root/proc"
mount -t sysfs -o ro sysfs "$root/sys" || mount --rbind -o ro /sys "$root/sys"
mount -t tmpfs -o mode=755 cgroup "$root/sys/fs/cgroup"
mkdir "$root/sys/fs/cgroup/systemd"
mount -t cgroup -o none,name=systemd,nosuid cgroup "$root/sys/fs/cgroup/systemd"
mount -t tmpfs -o mode=755 dev "$root/dev"
for device in null zero full random urandom tty; do
    touch "$root/dev/$device"
    mount --bind "/dev/$device" "$root/dev/$device"
done
mkdir "$root/dev/shm" "$root/dev/pts" "$root/dev/mqueue" "$root/dev/hugepages"
mount -t tmpfs -o mode=1777 shm "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx"
ln -s /proc/self/fd "$root/dev/fd"
ln -s /proc/self/fd/1 "$root/dev/stdout"
ln -s /proc/self/fd/2 "$root/dev/stderr"

mkdir "$root/mnt/dist" "$root/mnt/io"
mount --bind -o ro "$work/dist" "$root/mnt/dist"
mount --bind "$work/io" "$root/mnt/io"
cp "$work/changes/inside.sh" "$root/mnt/inside.sh"
ip link set lo up
hostname clean

cat > "$root/etc/systemd/system/trial.service" <<'UNIT'
[Unit]
Description=Trial of the package
After=basic.target
[Service]
ExecStart=/bin/bash /mnt/inside.sh
StandardOutput=file:/mnt/io/trial.log
StandardError=file:/mnt/io/trial.log
UNIT
cat > "$root/etc/systemd/system/trial.target" <<'UNIT'
[Unit]
Requires=basic.target trial.service
After=basic.target
AllowIsolate=yes
UNIT
exec chroot "$root" /usr/bin/env -i container=other PATH=/usr/sbin:/usr/bin:/sbin:/bin \
    /lib/systemd/systemd --system --unit=trial.target --log-target=console --show-status=0
