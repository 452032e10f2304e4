/* Plugin for qemu-arm 7.2: counts how often each instruction runs in each section of the baseline.
 *
 * Sections are marked by the hint DBG #section. At the end it prints a line for each instruction
 * that ran inside: its address, then its counts, to the file named by the argument "output=".
 *
 * The declarations below are of QEMU's plugin interface, version 1, which Debian's packages do not
 * carry; see "QEMU TCG Plugins" in QEMU's documentation.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef void (*on_translate)(qemu_plugin_id_t, struct qemu_plugin_tb *);
typedef void (*on_execute)(unsigned int, void *);
typedef void (*on_exit)(qemu_plugin_id_t, void *);
enum qemu_plugin_cb_flags { QEMU_PLUGIN_CB_NO_REGS };

void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t, on_translate);
void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *, on_execute,
                                            enum qemu_plugin_cb_flags, void *);
void qemu_plugin_register_atexit_cb(qemu_plugin_id_t, on_exit, void *);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);

__attribute__((visibility("default"))) int qemu_plugin_version = 1;

enum { SECTIONS = 5, PLACES = 1 << 18 };
static struct place {
    uint64_t address;
    uint64_t counts[SECTIONS];
} places[PLACES];
static unsigned section;
static FILE *output;

/* Instructions are translated again now and then, so their counts are found by address. */
static struct place *find(uint64_t address)
{
    unsigned i = (unsigned)(address >> 2) % PLACES;
    while (places[i].address != 0 && places[i].address != address)
        i = (i + 1) % PLACES;
    places[i].address = address;
    return &places[i];
}

static void count(unsigned cpu, void *place)
{
    (void)cpu;
    ((struct place *)place)->counts[section]++;
}

static void enter(unsigned cpu, void *number)
{
    (void)cpu;
    section = (unsigned)(uintptr_t)number;
}

static void translate(qemu_plugin_id_t id, struct qemu_plugin_tb *tb)
{
    (void)id;
    const size_t size = qemu_plugin_tb_n_insns(tb);
    for (size_t i = 0; i < size; i++) {
        struct qemu_plugin_insn *insn = qemu_plugin_tb_get_insn(tb, i);
        uint32_t word;
        memcpy(&word, qemu_plugin_insn_data(insn), sizeof word);
        if ((word & 0xfffffff0u) == 0xe320f0f0u && (word & 15u) < SECTIONS)
            qemu_plugin_register_vcpu_insn_exec_cb(insn, enter, QEMU_PLUGIN_CB_NO_REGS,
                                                   (void *)(uintptr_t)(word & 15u));
        else
            qemu_plugin_register_vcpu_insn_exec_cb(insn, count, QEMU_PLUGIN_CB_NO_REGS,
                                                   find(qemu_plugin_insn_vaddr(insn)));
    }
}

static void finish(qemu_plugin_id_t id, void *data)
{
    (void)id;
    (void)data;
    for (unsigned i = 0; i < PLACES; i++) {
        const struct place *p = &places[i];
        if (p->counts[1] | p->counts[2] | p->counts[3] | p->counts[4])
            fprintf(output, "%llx %llu %llu %llu %llu\n", (unsigned long long)p->address,
                    (unsigned long long)p->counts[1], (unsigned long long)p->counts[2],
                    (unsigned long long)p->counts[3], (unsigned long long)p->counts[4]);
    }
    fclose(output);
}

__attribute__((visibility("default"))) int qemu_plugin_install(qemu_plugin_id_t id,
                                                               const void *info, int argc,
                                                               char **argv)
{
    (void)info;
    for (int i = 0; i < argc; i++)
        if (!strncmp(argv[i], "output=", 7))
            output = fopen(argv[i] + 7, "w");
    if (output == NULL) {
        fputs("count: the argument output= must name a file that can be written\n", stderr);
        return 1;
    }
    qemu_plugin_register_vcpu_tb_trans_cb(id, translate);
    qemu_plugin_register_atexit_cb(id, finish, NULL);
    return 0;
}
