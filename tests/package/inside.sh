#!/bin/bash
# Trial of the package on the machine that boot.sh booted: each step writes what it found to /mnt/io/facts.
old=$(ls /mnt/dist/*.deb | sort | head -1)
new=$(ls /mnt/dist/*.deb | sort | tail -1)
services="spool@machine spool-recorder@machine"
recordings=/var/lib/spool/recordings/machine

fact() { echo "$1 $2" >> /mnt/io/facts; }
step() { echo; echo "== $(date +%T) $*"; }
state() { (cd /var/lib/spool && find . -type f | sort | xargs -r sha256sum | sha256sum | cut -c1-64); }
active() { systemctl is-active $services | sort -u | tr '\n' ' '; }
version() { dpkg-query -W -f '${Version}' spool-valves; }
property() { systemctl show -p "$2" --value "$1"; }
as_spool() {
    setpriv --reuid=spool --regid=spool --clear-groups env HOME=/var/lib/spool XDG_CACHE_HOME=/var/cache/spool \
        ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_LOG_DIR=/var/log/spool PYTHONDONTWRITEBYTECODE=1 "$@"
}
until_restarted() { # $1 unit, $2 seconds
    for _ in $(seq "$2"); do
        [ "$(property "$1" NRestarts)" -ge 1 ] && [ "$(systemctl is-active "$1")" = active ] && break
        sleep 1
    done
    fact "$3" "$(property "$1" NRestarts) $(systemctl is-active "$1")"
}

step network
fact links "$(ls /sys/class/net | tr '\n' ' ')"

step install
dpkg -i "$old"
fact installed "$(dpkg-query -W -f '${db:Status-Status}' spool-valves)"
fact version_old "$(version)"
systemd-analyze verify $(printf '%s.service ' $services) > /mnt/io/units 2>&1
fact unit_complaints "$(wc -l < /mnt/io/units)"
fact exposure "$(for unit in $services; do systemd-analyze security --no-pager "$unit.service" | tail -1 | grep -o '[0-9.]* [A-Z]*'; done | tr '\n' ' ')"

step start
systemctl start $services
fact started "$(active)"
systemctl enable $services
for valve in 1 2; do
    as_spool timeout -s INT 90 /opt/spool/spool run spool_sim simulator --ros-args -r __ns:=/valve_$valve \
        > /mnt/io/simulator_$valve.log 2>&1 &
done
wait
sleep 12

step recorder killed
systemctl kill -s KILL spool-recorder@machine
until_restarted spool-recorder@machine 60 recorder_killed

step host that hangs
host=$(property spool@machine MainPID)
kill -STOP "$host" $(pgrep -P "$host")
until_restarted spool@machine 200 host_hung

step upgrade while the services run
host=$(property spool@machine MainPID)
dpkg -i "$new"
sleep 5
fact upgraded_running "$(active)"
fact restarted_by_upgrade "$([ "$host" != "$(property spool@machine MainPID)" ] && echo yes || echo no)"
fact version_new "$(version)"

step recorded
systemctl stop $services
fact stopped "$(systemctl is-active $services | sort -u | tr '\n' ' ')"
sleep 1
as_spool /usr/bin/spool info $recordings | tee /mnt/io/info
fact alarms_of_valves "$(find /var/lib/spool/machine -name trends.sqlite.last | xargs grep -la '"kind": "stale"' | wc -l)"
fact baselines "$(find /var/lib/spool/machine -name trends.sqlite.last | xargs grep -la '"records"' | wc -l)"
as_spool /usr/bin/spool verify $recordings > /mnt/io/verify
fact verified "$?"
fact state_files "$(find /var/lib/spool -type f | wc -l)"
before=$(state)
kept() { [ "$before" = "$(state)" ] && fact "$1" same || fact "$1" changed; }

step rollback
dpkg -i "$old"
kept rollback
fact version_rolled_back "$(version)"

step upgrade
dpkg -i "$new"
kept upgrade

step started again
systemctl start $services
sleep 5
fact started_again "$(active)"
systemctl stop $services
before=$(state)

step remove
dpkg --remove spool-valves
kept remove
fact left_in_opt "$(ls -A /opt)"
fact settings_after_remove "$(ls /etc/spool/machine | tr '\n' ' ')"

step purge
dpkg --purge spool-valves
kept purge
fact left_after_purge "$(ls -d /etc/spool /var/cache/spool /var/log/spool 2>/dev/null)"
fact end yes
systemctl poweroff --force
