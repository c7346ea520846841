/* Calls a function of Embree once for each packet of rays. Set-up compiles it; called by ctypes, it
   runs without Python's lock. */

#include <stddef.h>

typedef void (*cast_function)(const int *valid, void *scene, void *packet, void *arguments);

void cast_packets(cast_function cast, const int *valid, void *scene, char *packets,
                  size_t packet_bytes, size_t count, void *arguments)
{
    for (size_t i = 0; i < count; i++)
        cast(valid, scene, packets + i * packet_bytes, arguments);
}
