// The simulated core with a C application in one process: a port whose other end is a cycle-accurate
// AXI4-Lite manager on the ports of the model that Verilator made of the Verilog.
//
//   program APPLICATION SCENARIO RESULTS COUNTS interrupt|polling estimates|covariances WORD_CLOCKS
//           TIMEOUT_US
//
// APPLICATION is a shared library, so that another one needs no other model. WORD_CLOCKS are the clocks that a bus word takes at least, on average. COUNTS gets a line of numbers:
// clocks, words, clocks of words, seconds, seconds of the processor.

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <memory>

#include <dlfcn.h>

#include "Vukf_core.h"
#include "verilated.h"

#include "run_files.h"

namespace {

constexpr std::uint64_t clocks_per_us = 100;

/// Clocks without an answer after which the bus must be dead.
constexpr unsigned patience = 1000;

/// The core, its clock, and a manager on its bus that does one access after the other.
class Bench {
public:
    explicit Bench(double word_clocks) : word_clocks_(word_clocks)
    {
        top_->aresetn = 0;
        tick(4);
        top_->aresetn = 1;
        tick(2);
    }

    ~Bench() { top_->final(); }

    bool read(std::uint32_t address, std::uint32_t *word)
    {
        const Word timing(*this);
        bool asked = false;
        top_->s_axi_araddr = address;
        top_->s_axi_arvalid = 1;
        top_->s_axi_rready = 1;
        for (unsigned waited = 0;; waited++) {
            settle();
            const bool taken = top_->s_axi_arvalid && top_->s_axi_arready;
            const bool answered = top_->s_axi_rvalid;
            if (answered && !asked && !taken) {
                fail("read data without a request");
            }
            const std::uint32_t data = top_->s_axi_rdata;
            const bool okay = top_->s_axi_rresp == 0;
            edge();
            if (taken) {
                asked = true;
                top_->s_axi_arvalid = 0;
            }
            if (answered) {
                top_->s_axi_rready = 0;
                *word = data;
                return okay;
            }
            give_up(waited);
        }
    }

    bool write(std::uint32_t address, std::uint32_t word)
    {
        const Word timing(*this);
        top_->s_axi_awaddr = address;
        top_->s_axi_awvalid = 1;
        top_->s_axi_wdata = word;
        top_->s_axi_wstrb = 0xf;
        top_->s_axi_wvalid = 1;
        top_->s_axi_bready = 1;
        for (unsigned waited = 0;; waited++) {
            settle();
            const bool address_taken = top_->s_axi_awvalid && top_->s_axi_awready;
            const bool word_taken = top_->s_axi_wvalid && top_->s_axi_wready;
            const bool answered = top_->s_axi_bvalid;
            const bool okay = top_->s_axi_bresp == 0;
            if (answered && ((top_->s_axi_awvalid && !address_taken) ||
                             (top_->s_axi_wvalid && !word_taken))) {
                fail("a response before the request");
            }
            edge();
            if (address_taken) {
                top_->s_axi_awvalid = 0;
            }
            if (word_taken) {
                top_->s_axi_wvalid = 0;
            }
            if (answered) {
                top_->s_axi_bready = 0;
                return okay;
            }
            give_up(waited);
        }
    }

    bool wait(std::uint32_t timeout_us)
    {
        const std::uint64_t deadline = clocks_ + timeout_us * clocks_per_us;
        while (!top_->irq && clocks_ < deadline) {
            tick(1);
        }
        return top_->irq;
    }

    std::uint64_t clocks() const { return clocks_; }
    std::uint64_t words() const { return words_; }
    std::uint64_t word_clocks() const { return clocks_of_words_; }

private:
    /// Counts a word, and lets it take its time.
    class Word {
    public:
        explicit Word(Bench &bench) : bench_(bench), start_(bench.clocks_) {}

        ~Word()
        {
            bench_.owed_ += bench_.word_clocks_;
            const double taken = static_cast<double>(bench_.clocks_ - start_);
            if (bench_.owed_ - taken >= 1.0) {
                bench_.tick(static_cast<unsigned>(bench_.owed_ - taken));
            }
            const std::uint64_t clocks = bench_.clocks_ - start_;
            bench_.owed_ -= static_cast<double>(clocks);
            if (bench_.owed_ < 0.0) {
                bench_.owed_ = 0.0;
            }
            bench_.words_++;
            bench_.clocks_of_words_ += clocks;
        }

    private:
        Bench &bench_;
        std::uint64_t start_;
    };

    /// The first half of a clock: outputs follow the inputs.
    void settle()
    {
        top_->aclk = 0;
        top_->eval();
    }

    /// The rising edge.
    void edge()
    {
        top_->aclk = 1;
        top_->eval();
        clocks_++;
    }

    void tick(unsigned count)
    {
        while (count--) {
            settle();
            edge();
        }
    }

    [[noreturn]] void fail(const char *what) const
    {
        std::fprintf(stderr, "clock %llu: %s\n", static_cast<unsigned long long>(clocks_), what);
        std::exit(3);
    }

    void give_up(unsigned waited) const
    {
        if (waited >= patience) {
            fail("no answer on the bus");
        }
    }

    std::unique_ptr<Vukf_core> top_{new Vukf_core};
    double word_clocks_;
    double owed_ = 0.0;
    std::uint64_t clocks_ = 0;
    std::uint64_t words_ = 0;
    std::uint64_t clocks_of_words_ = 0;
};

bool read_word(void *context, std::uint32_t address, std::uint32_t *word)
{
    return static_cast<Bench *>(context)->read(address, word);
}

bool write_word(void *context, std::uint32_t address, std::uint32_t word)
{
    return static_cast<Bench *>(context)->write(address, word);
}

bool wait_for_interrupt(void *context, std::uint32_t timeout_us)
{
    return static_cast<Bench *>(context)->wait(timeout_us);
}

std::uint64_t now_us(void *context)
{
    return static_cast<Bench *>(context)->clocks() / clocks_per_us;
}

/// ukf_run_files() of an application; nullptr after a message if there is none.
decltype(&ukf_run_files) load(const char *path)
{
    void *const library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    void *const function = library ? dlsym(library, "ukf_run_files") : nullptr;
    if (!function) {
        std::fprintf(stderr, "%s\n", dlerror());
    }
    return reinterpret_cast<decltype(&ukf_run_files)>(function);
}

} // namespace

int main(int count, char **arguments)
{
    if (count != 9) {
        std::fprintf(stderr, "usage: %s APPLICATION SCENARIO RESULTS COUNTS interrupt|polling "
                             "estimates|covariances WORD_CLOCKS TIMEOUT_US\n", arguments[0]);
        return 2;
    }
    const auto run_files = load(arguments[1]);
    if (!run_files) {
        return 1;
    }
    Bench bench(std::atof(arguments[7]));
    const bool polling = std::strcmp(arguments[5], "polling") == 0;
    const bool covariances = std::strcmp(arguments[6], "covariances") == 0;
    const ukf_port port = {&bench, read_word, write_word, polling ? nullptr : wait_for_interrupt,
                           now_us};
    const auto start = std::chrono::steady_clock::now();
    const std::clock_t processor_start = std::clock();
    const int code = run_files(&port, arguments[2], arguments[3],
                               static_cast<std::uint32_t>(std::atol(arguments[8])), covariances);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    const double processor_seconds =
        static_cast<double>(std::clock() - processor_start) / CLOCKS_PER_SEC;
    std::FILE *counts = std::fopen(arguments[4], "w");
    if (!counts) {
        std::perror(arguments[4]);
        return 1;
    }
    std::fprintf(counts, "%llu %llu %llu %.9f %.9f\n",
                 static_cast<unsigned long long>(bench.clocks()),
                 static_cast<unsigned long long>(bench.words()),
                 static_cast<unsigned long long>(bench.word_clocks()), seconds.count(),
                 processor_seconds);
    std::fclose(counts);
    return code;
}
