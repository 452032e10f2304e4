# Every target is one command; `make` alone lists them. All but `help` and `clean` first make the
# environment in .venv, once. An own environment is used instead with `make VENV=path`.
.DEFAULT_GOAL := help
.PHONY: help demo install test test-fast test-slow cosim apps figures formal mutants resources sweep report growth routing bench numerics rounding iteration elementary coefficients refresh docs zynq zynq-tools zynq-c package-check fusesoc baseline check lint types wheel-check format clean

PYTHON ?= python3
VENV   ?= .venv
JOBS   ?= 2
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

# Images of containers often set this; here hundreds of processes would compile the same modules.
unexport PYTHONDONTWRITEBYTECODE

help: ## List the targets
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 14

# --group needs pip 25.1. Compiling everything would take as long as the rest; Python compiles a
# module when it is first imported.
$(STAMP): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 is needed")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "Installing into $(VENV): minutes, the first time"
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	$(BIN)/python -m pip install --quiet --no-compile --editable . --group dev
	touch $@

install: $(STAMP) ## Make the environment in .venv

demo: $(STAMP) ## Generate the core with 2 PEs; run 1.5 s of the nanosatellite on it (1 to 2 minutes)
	@echo "Generating the core, then compiling it and simulating 1.5 s of flight: 1 to 2 minutes on 2 cores"
	$(BIN)/ukf generate --problem nanosat --pes 2 --output build/demo/core
	$(BIN)/ukf c-loop --problem nanosat --pes 2 --steps 1500 --plot build/demo/attitude.png
	@echo
	@echo "A satellite's attitude was estimated 1000 times a second by the generated Verilog in build/demo/core,"
	@echo "clock by clock, driven by the C code that a board would run; every bit equals the golden model's."
	@echo "What next:"
	@echo "  look at build/demo/attitude.png, the errors and the filter's own 3 standard deviations"
	@echo "  choose a core: ukf latency --problem nanosat --pes 10, and docs/design-space.md"
	@echo "  bring your own filter: ukf new my-filter, and docs/own-model.md"

test: $(STAMP) ## Run all tests but the exhaustive ones
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "not slow"

test-fast: $(STAMP) ## Run the tests that compile nothing
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "not slow and not system"

test-slow: $(STAMP) ## Run everything, the exhaustive tests included
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal

cosim: $(STAMP) ## Co-simulate; OPTIONS="--problem nanosat --pes 2 ..."
	$(BIN)/ukf cosim $(or $(OPTIONS),--problem nanosat --pes 2)

apps: $(STAMP) ## Run every application, models in software and on the core, and co-simulate some steps
	$(BIN)/ukf apps all --cosim-steps 30 --workers $(JOBS)

figures: apps demo ## Run them and the demonstration, and put tables and figures into the documents
	$(BIN)/python -m ukf_docs applications
	cp build/demo/attitude.png docs/figures/demo.png

formal: $(STAMP) ## Prove the properties of the bus and control logic
	$(BIN)/python -m support.formal

mutants: $(STAMP) ## Break the project on purpose and demand that tests fail
	$(BIN)/python tests/mutants/run.py

resources: $(STAMP) ## Synthesise for 7-series and note the resources for the README
	$(BIN)/python -m ukf_docs measure resources

package-check: $(STAMP) ## Package the core for both boards, and check the scripts
	$(BIN)/ukf package --problem nanosat --pes 2 --board zedboard --output build/package/zedboard
	$(BIN)/ukf package --problem nanosat --pes 2 --board pynq-z2 --output build/package/pynq-z2

fusesoc: $(STAMP) ## Lint and simulate the core through FuseSoC
	$(BIN)/python tools/fusesoc/run.py run --build-root build/fusesoc --target=lint ukf::ukf_core
	$(BIN)/python tools/fusesoc/run.py run --build-root build/fusesoc --target=sim ukf::ukf_core

build/armhf:
	tools/ukf_tools/baseline/c/fetch-gsl.sh $@

baseline: $(STAMP) build/armhf ## Compare with the filter wholly in software on a Cortex-A9
	$(BIN)/python -m ukf_docs measure baseline

SWEEP := --problem nanosat --pes 1,2,4,5,8,10,11,16,22 --form square-root,covariance --accuracy nanosat
sweep: $(STAMP) ## Sweep processing elements and forms with synthesis; resumes, OPTIONS=... for another
	$(BIN)/ukf sweep $(or $(OPTIONS),$(SWEEP))

report: $(STAMP) ## Make build/report.html of the last sweep, and its figures in docs/figures
	$(BIN)/ukf report --figures docs/figures/design-space

growth: $(STAMP) ## Note how cycles grow with states and processing elements
	$(BIN)/python -m ukf_docs measure growth

routing: $(STAMP) ## Place and route for ECP5, a proxy for routed timing, and note it (slow)
	$(BIN)/python -m ukf_docs measure routing

bench: $(STAMP) ## Measure the speed of simulation, models, generator and sweeps, and note it
	$(BIN)/python -m ukf_docs measure bench

numerics: $(STAMP) ## Measure formats, forms and W0 on the applications, and note it
	$(BIN)/python -m ukf_docs measure numerics

rounding: $(STAMP) ## Measure which roundings cost the nanosatellite accuracy, and note it (slow)
	$(BIN)/python -m ukf_docs measure rounding

elementary: $(STAMP) ## Measure errors of the elementary functions, and note them
	$(BIN)/python -m ukf_docs measure elementary

coefficients: $(STAMP) ## Make the elementary functions' polynomials; FORMATS="float6.17 ..." for others
	$(BIN)/python -m ukf_docs coefficients $(FORMATS)

iteration: $(STAMP) ## Co-simulate iterations with the 2018 paper's bus, and note the traffic
	$(BIN)/python -m ukf_docs measure iteration

refresh: $(STAMP) ## Make the generated tables, diagrams and printed results of the documents again
	$(BIN)/python -m ukf_docs refresh
	$(BIN)/python -m ukf_docs pages

docs: $(STAMP) ## Build the documentation as a site in build/docs; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

zynq: zynq-tools zynq-c package-check fusesoc build/armhf ## Make and check what goes on a Zynq
	$(BIN)/ukf baseline --sysroot build/armhf

ZYNQ_PACKAGES := device-tree-compiler gcc-arm-linux-gnueabihf libc6-dev-armhf-cross qemu-user \
	libgsl-dev llvm-14 python3-tk iverilog

zynq-tools: # Debian's packages that are missing: installed by root, else named
	@missing=$$(for package in $(ZYNQ_PACKAGES); do dpkg -s $$package >/dev/null 2>&1 || echo $$package; done); \
	if [ -z "$$missing" ]; then exit 0; fi; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then apt-get install -qy $$missing; \
	else echo "These Debian packages are missing; what needs them is skipped:" $$missing; fi

zynq-c: $(STAMP) ## Run the C driver on the simulated core and on an emulated ARM
	$(BIN)/ukf generate --problem nanosat --pes 2 --output build/zynq/core
	$(BIN)/ukf export --problem nanosat --steps 1000 --output build/zynq/data
	$(BIN)/python -m pytest tests/hdl/test_interfaces.py tests/system/test_c_driver.py \
		tests/system/test_c_ports.py tests/system/test_c_programs.py tests/system/test_c_loop.py \
		tests/system/test_c_models.py tests/system/test_c_models_on_core.py \
		tests/system/test_c_programs_on_core.py tests/system/test_c_problem.py \
		tests/system/test_c_catalogue.py -m "not slow"
	$(BIN)/ukf c-loop --problem nanosat --pes 2 --steps 1000 --beside-cocotb 30
	$(BIN)/ukf c-loop --problem nanosat --pes 10 --models core
	@if command -v arm-linux-gnueabihf-gcc >/dev/null && command -v qemu-arm >/dev/null; then \
		$(BIN)/ukf c-arm --problem nanosat --pes 2 --steps 1000 --output build/zynq/arm; \
	else echo "No arm-linux-gnueabihf-gcc or qemu-arm here: the ARM part is skipped"; fi

check: $(STAMP) ## All that continuous integration runs: lint, types, docs, test, wheel-check
	@for target in lint types docs test wheel-check; do \
		echo "== make $$target, at $$(date +%H:%M:%S)"; $(MAKE) --no-print-directory $$target || exit 1; \
	done

lint: $(STAMP) ## Check style
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP) ## Check types
	$(BIN)/pyright --pythonpath $(BIN)/python

wheel-check: $(STAMP) ## Build the wheel, install it in new environments, and use it there
	$(BIN)/python tests/wheel/check.py

format: $(STAMP) ## Format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean: ## Remove everything generated
	rm -rf build .pytest_cache .ruff_cache
