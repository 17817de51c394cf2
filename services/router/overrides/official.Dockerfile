# The nodes' image with mavp2p as its authors published it, instead of the one built from go.mod (docs/mavlink.md).
FROM bluenviron/mavp2p:1.3.3 AS official
FROM mqttxt-testbed/node:latest
COPY --from=official /mavp2p /usr/local/bin/mavp2p
