# A machine in namespaces of its own, for tests: systemd as its PID 1, the files of a root below it:
#   unshare --cgroup --mount --pid --fork --uts --ipc --net --kill-child sh machine.sh FOLDER ROOT CHECKOUT PYTHON
#
# ROOT is /, that of this host: what the machine writes goes into memory and is gone with it. Or that
# of another system, which it may change. Of the host's kernel it may load no module, set no clock
# and change no setting.
set -eu
folder=$1 root=$2 checkout=$3 python=$4

mount --make-rprivate /
mount -t tmpfs -o mode=0755 tmpfs "$folder"
mkdir "$folder/upper" "$folder/work" "$folder/root"
if [ "$root" = / ]; then
    mount -t overlay -o "lowerdir=/,upperdir=$folder/upper,workdir=$folder/work" overlay "$folder/root"
else
    mount --bind "$root" "$folder/root"
fi
cd "$folder/root"
mkdir -p mnt

if [ "$root" = / ]; then
    # At places that every user of the machine can read: here they may lie in somebody's home.
    mkdir -p opt/checkout opt/python
    mount --bind "$checkout" opt/checkout
    mount --bind "$python" opt/python
    for of_here in opt/checkout opt/python; do mount -o remount,ro,bind $of_here; done
    # The host's own units, users and settings are none of the machine's.
    for of_host in etc/systemd/system etc/udev etc/sysusers.d etc/tmpfiles.d etc/armrig home; do
        rm -rf $of_host
        mkdir -p $of_host
    done
    rm -rf var/lib/armrig var/log/journal opt/armrig
    awk -F: '$3 >= 1000 && $3 < 60000 { print $1 }' etc/passwd | xargs -rn1 userdel --force --prefix "$PWD"
fi

mount -t tmpfs -o mode=0755 tmpfs run
for of_all in tmp var/tmp; do mount -t tmpfs -o mode=1777 tmpfs $of_all; done
mount -t proc proc proc
mount --bind proc/sys proc/sys
mount -o remount,ro,bind proc/sys
mount -t sysfs -o ro sysfs sys
mount -t cgroup2 cgroup2 sys/fs/cgroup
mount -t tmpfs -o mode=0755 tmpfs dev
mkdir dev/pts dev/shm
mount -t devpts -o newinstance,ptmxmode=0666,mode=0620,gid=5 devpts dev/pts
mount -t tmpfs -o mode=1777 tmpfs dev/shm
ln -s pts/ptmx dev/ptmx
ln -s /proc/self/fd dev/fd
for name in null zero full random urandom tty cpu_dma_latency; do
    cp -a /dev/$name dev/  # a node of the machine's own, whose mode it may change
done

pivot_root . mnt
cd /
umount -l /mnt

# A Python with a shared library looks for it where it was built. If that is a home, which the unit
# hides, the loader takes that of the host's Python of the same version, and no module fits it.
if [ "$root" = / ] && [ "$python" != /usr ]; then
    echo /opt/python/lib > etc/ld.so.conf.d/0-python.conf
    ldconfig
fi
exec setpriv --bounding-set=-sys_module,-sys_time,-sys_rawio,-syslog,-mac_admin,-mknod \
    env -i container=other PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
    /lib/systemd/systemd --system --unit=basic.target
