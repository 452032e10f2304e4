"""A testbench in plain Verilog: it replays what a driver did to the golden model.

A filter runs on the golden model, and every access of its driver is noted with the model's answer.
The testbench makes the same accesses to the Verilog and compares every word it reads.
"""

from pathlib import Path

from ukf_hdl.instance import NAME
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import StepError
from ukf_sw.folders import check_folder
from ukf_sw.golden import GoldenBus, GoldenCore
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run
from ukf_sw.spec.memory_map import MemoryMap

__all__ = ["record", "write"]

_WRITE, _READ, _WAIT = 1, 2, 3


class _Recorder:
    """The golden model's bus, which notes what is done: (what, address, word)."""

    def __init__(self, bus: GoldenBus) -> None:
        self._bus = bus
        self.accesses: list[tuple[int, int, int]] = []

    def read(self, address: int) -> int:
        word = self._bus.read(address)
        self.accesses.append((_READ, address, word))
        return word

    def write(self, address: int, word: int) -> None:
        self._bus.write(address, word)
        self.accesses.append((_WRITE, address, word))

    def wait_for_interrupt(self, timeout: float) -> bool:
        self.accesses.append((_WAIT, 0, 0))
        return self._bus.wait_for_interrupt(timeout)


def record(recipe: Recipe, steps: int) -> list[tuple[int, int, int]]:
    """Run a filter on the golden model and note every access.

    Parameters
    ----------
    recipe
        How to make the scenario.
    steps
        How many iterations.

    Returns
    -------
    list of tuple
        What (1 write, 2 read, 3 wait for the interrupt), byte address, and word written or read.

    Raises
    ------
    ValueError
        If the scenario has fewer steps, or the filter fails on it.
    """
    bus = _Recorder(GoldenBus(GoldenCore(recipe.params)))
    driver = Driver(bus, recipe.params, interrupt=bus.wait_for_interrupt)
    try:
        run(recipe.scenario(steps), driver, steps=steps, covariance=True)
    except StepError as error:
        raise ValueError(f"steps must succeed, not stop with: {error}") from error
    return bus.accesses


_TEXT = """\
// Replays a filter's bus accesses and compares every word. Generated, do not edit.
`timescale 1ns / 1ps
module {name}_tb;
  localparam COUNT = {count}, WIDTH = {width}, PATIENCE = {patience};
  reg [71:0] accesses [0:COUNT-1];  // what, address, word
  reg clock = 0, resetn = 0;
  reg [WIDTH-1:0] address = 0;
  reg [31:0] data = 0;
  reg awvalid = 0, wvalid = 0, bready = 0, arvalid = 0, rready = 0;
  wire awready, wready, bvalid, arready, rvalid, irq;
  wire [1:0] bresp, rresp;
  wire [31:0] rdata;
  integer i, errors = 0, patience;

  {name} dut (
    .aclk(clock), .aresetn(resetn), .irq(irq),
    .s_axi_awaddr(address), .s_axi_awprot(3'b0), .s_axi_awvalid(awvalid), .s_axi_awready(awready),
    .s_axi_wdata(data), .s_axi_wstrb(4'b1111), .s_axi_wvalid(wvalid), .s_axi_wready(wready),
    .s_axi_bresp(bresp), .s_axi_bvalid(bvalid), .s_axi_bready(bready),
    .s_axi_araddr(address), .s_axi_arprot(3'b0), .s_axi_arvalid(arvalid), .s_axi_arready(arready),
    .s_axi_rdata(rdata), .s_axi_rresp(rresp), .s_axi_rvalid(rvalid), .s_axi_rready(rready)
  );

  always #5 clock = ~clock;

  // Signals change on the falling edge, so every simulator sees the same.
  task late;
    begin
      patience = patience - 1;
      if (patience == 0) begin
        $display("FAIL: access %0d has no end", i);
        $finish;
      end
      @(negedge clock);
    end
  endtask

  task write_word;
    begin
      awvalid = 1; wvalid = 1; bready = 1;
      while (awvalid || wvalid) begin
        // What is ready now is taken on the rising edge.
        if (awready && wready) begin @(negedge clock); awvalid = 0; wvalid = 0; end
        else if (awready && awvalid) begin @(negedge clock); awvalid = 0; end
        else if (wready && wvalid) begin @(negedge clock); wvalid = 0; end
        else late;
      end
      while (!bvalid) late;
      if (bresp != 2'b00) begin
        errors = errors + 1;
        $display("FAIL: write to %h refused", address);
      end
      @(negedge clock);
      bready = 0;
    end
  endtask

  task read_word;
    begin
      arvalid = 1; rready = 1;
      while (!arready) late;
      @(negedge clock);
      arvalid = 0;
      while (!rvalid) late;
      if (rresp != 2'b00 || rdata !== accesses[i][31:0]) begin
        errors = errors + 1;
        $display("FAIL: access %0d, %h holds %h, not %h", i, address, rdata, accesses[i][31:0]);
      end
      @(negedge clock);
      rready = 0;
    end
  endtask

  initial begin
    $readmemh("{vectors}", accesses);
    repeat (4) @(negedge clock);
    resetn = 1;
    repeat (2) @(negedge clock);
    for (i = 0; i < COUNT; i = i + 1) begin
      patience = PATIENCE;
      address = accesses[i][32 +: WIDTH];
      data = accesses[i][31:0];
      case (accesses[i][71:64])
        8'h01: write_word;
        8'h02: read_word;
        8'h03: while (!irq) late;
        default: begin errors = errors + 1; $display("FAIL: access %0d is unknown", i); end
      endcase
    end
    if (errors == 0) $display("PASS: %0d accesses", COUNT);
    else $display("FAIL: %0d errors", errors);
    $finish;
  end
endmodule
"""


def write(recipe: Recipe, steps: int, output: Path, *, name: str = NAME) -> list[Path]:
    """Write the testbench to a folder.

    Parameters
    ----------
    recipe, steps
        As for :func:`record`.
    output
        Folder to write to; made if absent.
    name
        Name of the core.

    Returns
    -------
    list of Path
        The module, and what it replays.

    Raises
    ------
    ValueError
        As :func:`record`, or if the folder cannot be written to, before anything else is done.
    """
    check_folder("output", output)
    accesses = record(recipe, steps)
    output.mkdir(parents=True, exist_ok=True)
    bench, vectors = output / f"{name}_tb.v", output / f"{name}_tb.hex"
    bench.write_text(
        _TEXT.format(
            count=len(accesses),
            width=MemoryMap(recipe.params).address_width,
            patience=100_000,
            vectors=vectors.name,
            name=name,
        ),
        encoding="utf-8",
    )
    lines = (f"{what:02x}{address:08x}{word:08x}" for what, address, word in accesses)
    vectors.write_text("\n".join([*lines, ""]), encoding="ascii")
    return [bench, vectors]
