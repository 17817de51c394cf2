ATTEMPTS ?= 1
# How many tests run at a time: most of them wait most of their time.
WORKERS ?= 8
ARM ?= thesis
PROFILE ?= ideal
SHAPER ?= auto
PROTOCOLS ?= mqttxt,mavlink
ENCODING ?= cbor
SAMPLES ?= 30
COUNT ?= 10
# What `make all` flies, lists with commas; empty: all of them.
EXPERIMENTS ?=
ARMS ?=
PROFILES ?=
# Factors, each by itself; empty: the arm's.
STREAMS ?=
COMMANDING ?=
QOS ?=
CHAIN ?=
STATES ?=
SECURITY ?=
STATION ?=
TCP ?=
AIR ?=
# Not empty: the flights are shown on the live page, and do not count.
PAGE ?=
# What `make reproduce` draws from; empty: the table's own seed.
SEED ?=
# Campaigns on many machines: where the scheduler is, and what makes machines those of one campaign.
SCHEDULER ?=
CERTIFICATE ?= campaign.pem
PORT ?= 8786
FACTORS = --streams '$(STREAMS)' --commanding '$(COMMANDING)' --qos '$(QOS)' --chain '$(CHAIN)' --states '$(STATES)' --security '$(SECURITY)' --station '$(STATION)' --tcp '$(TCP)' --air '$(AIR)'
# One fleet can be up at a time: where nobody chose a protocol it is MQTT-XT's.
ONE_PROTOCOL = $(if $(filter file,$(origin PROTOCOLS)),mqttxt,$(PROTOCOLS))
BOOTSTRAP := python3 -m testbed.bootstrap
PYTHON := .venv/bin/python
# What Python compiles is kept, but not beside the sources: a process starts in half the time.
export PYTHONPYCACHEPREFIX ?= $(CURDIR)/.cache/pycache
export PYTHONDONTWRITEBYTECODE =

.DEFAULT_GOAL := help
.PHONY: help messages scenario-1 scenario-2 scenario-3 scenario-4 scenario-5 all reproduce certificate scheduler worker summary arms links up down report test check soak bench docs sitl doctor lock upgrade clean venv containers tools

help: ## Say what each target does
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | awk -F':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

messages: ## Ten kinds of messages with one drone, COUNT of each (COUNT= ATTEMPTS= ARM= PROFILE= PROTOCOLS=)
scenario-1: ## Fly scenario 1 over both: arm, takeoff, hold, land, disarm (ATTEMPTS= ARM= PROFILE=lte PROTOCOLS= SECURITY= FOGS= DRONES= MACHINES=ssh://a,ssh://b PAGE=1)
scenario-2: ## The same with a point of its own for each drone, and the way back (ATTEMPTS= ARM= PROFILE= PROTOCOLS=)
scenario-3: ## Only up and down (ATTEMPTS= ARM= PROFILE= PROTOCOLS=)
scenario-4: ## As 2, and at its point each collects what a sensor measures there (SAMPLES= ATTEMPTS= ARM= PROFILE= PROTOCOLS=)
scenario-5: ## Upload a survey of 100 items to each drone and fly it (ATTEMPTS= ARM= PROFILE=geo-2s PROTOCOLS=)
messages scenario-1 scenario-2 scenario-3 scenario-4 scenario-5: containers
	@$(PYTHON) -m testbed run $@ --attempts '$(ATTEMPTS)' --arm '$(ARM)' --profile '$(PROFILE)' --shaper '$(SHAPER)' --protocols '$(PROTOCOLS)' --samples '$(SAMPLES)' --count '$(COUNT)' $(FACTORS) $(if $(PAGE),--page)

all: containers ## Fly everything, or go on where that was broken off (ATTEMPTS= EXPERIMENTS= ARMS= PROFILES= FOGS= DRONES= SCHEDULER=)
	@$(PYTHON) -m testbed all --attempts '$(ATTEMPTS)' --experiments '$(EXPERIMENTS)' --arms '$(ARMS)' --profiles '$(PROFILES)' --shaper '$(SHAPER)' --samples '$(SAMPLES)' --count '$(COUNT)' --scheduler '$(SCHEDULER)' --certificate '$(CERTIFICATE)'

reproduce: containers ## Fly the headline table, and say whether its findings are reproduced (ATTEMPTS= SEED=)
	@$(PYTHON) -m testbed reproduce --attempts '$(if $(filter file,$(origin ATTEMPTS)),,$(ATTEMPTS))' --seed '$(SEED)'

certificate: venv ## Make the certificate of a campaign on many machines, for all of them (CERTIFICATE=campaign.pem)
	@$(PYTHON) -m testbed certificate '$(CERTIFICATE)'

scheduler: venv ## Run the scheduler of a campaign on many machines (CERTIFICATE= PORT=8786)
	@$(PYTHON) -m testbed scheduler --port '$(PORT)' --certificate '$(CERTIFICATE)'

worker: containers ## Fly for campaigns on many machines (SCHEDULER=tls://host:8786 CERTIFICATE= MACHINE=)
	@$(PYTHON) -m testbed worker --scheduler '$(SCHEDULER)' --certificate '$(CERTIFICATE)'

summary: venv ## All experiments, arms and profiles beside each other, from the results folder: a page
	@$(PYTHON) -m testbed summary

links: containers ## Probe the links of all profiles, configured beside measured, without flying (PROFILE=lte,sik)
	@$(PYTHON) -m testbed links --profile '$(if $(filter file,$(origin PROFILE)),,$(PROFILE))' --shaper '$(SHAPER)'

arms: venv ## Say what the arms and the factors are (ARM= STREAMS= COMMANDING= QOS= CHAIN= STATES= SECURITY= TCP= AIR=)
	@$(PYTHON) -m testbed arms

up: containers ## Start the fleet and leave them running, to explore by hand (PROTOCOLS=mavlink, PROFILE=lte, SECURITY=none, FOGS= DRONES=)
	@$(PYTHON) -m testbed up --protocol '$(ONE_PROTOCOL)' --arm '$(ARM)' $(FACTORS) --encoding '$(ENCODING)' --profile '$(PROFILE)' --shaper '$(SHAPER)'

down: containers ## End what `make up` started
	@$(PYTHON) -m testbed down

report: venv ## Make metrics and report of the newest results again, without Docker
	@$(PYTHON) -m testbed report results/*/latest

# Runs pytest with lint beside it, whose lines come at the end where it fails: lint has one process and tests wait now
# and then, so that beside each other they leave no core idle.
beside-lint = @$(1) $(MAKE) --no-print-directory lint > .cache/lint.log 2>&1 & lint=$$!; \
	$(PYTHON) -m pytest $(2) --dist loadfile; tested=$$?; \
	wait $$lint; linted=$$?; [ $$linted = 0 ] || cat .cache/lint.log; exit $$((linted | tested))

test: containers tools ## Run every check and every test, WORKERS= at a time; of `make soak` what has changed
	$(call beside-lint,nice,--numprocesses '$(WORKERS)' --no-loadscope-reorder)

check: venv ## Format, lint, types, import rules and unit tests, in about a minute
	$(call beside-lint,,-q tests/unit -m 'not long' --hypothesis-profile quick --numprocesses 2)

soak: containers tools ## Run long tests of what has changed since they passed, or ALL=1; then commit tests/soak.json
	@$(PYTHON) -m pytest -m soak $(if $(ALL),--soak-all)

lint: venv
	@.venv/bin/ruff format --check --quiet . && .venv/bin/ruff check --quiet .
	@.venv/bin/mypy
	@PYTHONPATH=. .venv/bin/lint-imports --no-cache > .cache/imports.log || (cat .cache/imports.log; exit 1)

bench: containers tools ## Measure speed and load, as shares and ratios of one run
	@$(PYTHON) -m tests.bench

docs: venv ## Make schemas, tables and pictures anew from the code, and the site from docs/
	@$(PYTHON) -m spec.schema services/mqttxt/src/mqttxt/protocol/schemas
	@$(PYTHON) -m spec.tables docs/protocol.md
	@$(PYTHON) -m spec.pictures docs/pictures
	@$(PYTHON) -m spec.options docs/activator.md docs/conformance.md docs/gateway.md docs/ground-station.md docs/homeassistant.md docs/metrics.md docs/page.md docs/security.md docs/tutorial.md docs/uav-client.md
	@$(PYTHON) -m spec.brokers docs/brokers.md
	@$(PYTHON) -m spec.scale docs/scale.md
	@NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict > .cache/site.log 2>&1 || (cat .cache/site.log; exit 1)
	@echo "site: .cache/site/index.html"

sitl: venv ## Fly one simulated autopilot on loopback; prints how to connect to it
	@$(PYTHON) -m sitl fly --gcs

doctor: ## Say what is there, what is missing, and what to type
	@$(BOOTSTRAP) doctor
	@python3 -m tests.tools doctor

lock: venv ## Pin what is new in requirements/*.in, and leave the other pins as they are
	@$(BOOTSTRAP) lock

upgrade: venv ## Pin the newest version of every requirement
	@$(BOOTSTRAP) upgrade

clean: ## Remove the virtual environment and caches; results stay
	@rm -rf .venv .cache .mypy_cache .ruff_cache .pytest_cache

venv:
	@$(BOOTSTRAP) venv

tools:
	@python3 -m tests.tools make

containers: venv
	@$(BOOTSTRAP) containers
