/* The logger callback an FMI 2.0 host gives to an FMU takes variable arguments, which stable Rust cannot define:
   this shim formats the message and hands it on. */

#include <stdarg.h>
#include <stdio.h>

/* in journal.rs */
void metafmu_journal_add(void *journal, int status, const char *category, const char *message);

void metafmu_logger(void *environment, const char *instance, int status, const char *category, const char *format, ...)
{
    char message[4096]; /* a longer message is cut */
    va_list arguments;
    (void)instance;
    if (!environment || !format)
        return;
    va_start(arguments, format);
    if (vsnprintf(message, sizeof message, format, arguments) >= 0)
        metafmu_journal_add(environment, status, category ? category : "", message);
    va_end(arguments);
}
