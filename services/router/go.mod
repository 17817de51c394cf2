module mqttxt-testbed/router

go 1.25.0

tool github.com/bluenviron/mavp2p

require (
	github.com/alecthomas/kong v1.15.0 // indirect
	github.com/bluenviron/gomavlib/v3 v3.3.4 // indirect
	github.com/bluenviron/mavp2p v1.3.3 // indirect
	github.com/creack/goselect v0.1.2 // indirect
	github.com/pion/logging v0.2.2 // indirect
	github.com/pion/transport/v2 v2.2.10 // indirect
	go.bug.st/serial v1.6.4 // indirect
	golang.org/x/net v0.38.0 // indirect
	golang.org/x/sys v0.31.0 // indirect
)
