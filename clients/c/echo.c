/* An event handler of CTOS in plain C. It takes `double` { number = "int" } -> "int", and keeps how often it was asked.
   A whole program would read JSON with a library; this one looks for the keys that it needs. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The number behind "key": in the line, or 0. */
static long number(const char *line, const char *key) {
    char quoted[32];
    snprintf(quoted, sizeof quoted, "\"%s\":", key);
    const char *at = strstr(line, quoted);
    return at ? strtol(at + strlen(quoted), NULL, 10) : 0;
}

static int is(const char *line, const char *kind) {
    size_t length = strlen(kind);
    return line[0] == '{' && line[1] == '"' && strncmp(line + 2, kind, length) == 0 && line[2 + length] == '"';
}

int main(void) {
    char *line = NULL;
    size_t size = 0;
    long asked = 0;
    /* Each line is sent when it is written: the other side waits for it. */
    setvbuf(stdout, NULL, _IOLBF, 0);
    while (getline(&line, &size, stdin) > 0) {
        if (is(line, "hello")) {
            asked = number(line, "asked"); /* what an earlier one kept, if there was one */
            puts("{\"hello\":{\"protocol\":1,\"commands\":[{\"name\":\"double\"}]}}");
        } else if (is(line, "step")) {
            /* In virtual time: all before it is done. The line goes back as it came. */
            fputs(line, stdout);
        } else if (is(line, "message")) {
            long id = number(line, "id");
            if (strstr(line, "\"command\":\"double\"")) {
                printf("{\"keep\":{\"state\":{\"asked\":%ld}}}\n", ++asked);
                printf("{\"reply\":{\"id\":%ld,\"data\":%ld}}\n", id, 2 * number(line, "number"));
            } else {
                printf("{\"error\":{\"id\":%ld,\"text\":\"no such command\"}}\n", id);
            }
        } else if (is(line, "stop")) {
            break;
        } /* "run", "reply" and "error" are for programs that ask others. */
    }
    free(line);
    return 0;
}
