/* A camera opened by libcaer: `libcaer_client MODEL SECONDS OUT`.
 *
 * Writes each event as 16 bytes to OUT: time in us (i64), x, y, polarity (u16 each), 2 bytes of 0. Prints one line of
 * JSON: the sensor's size, the number of timestamps that came after the last event, and a bias as it was set and as it
 * was read back. Special events with a timestamp reset begin the recording anew, as a program would do. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <libcaer/devices/davis.h>
#include <libcaer/devices/dvs128.h>
#include <libcaer/devices/dvxplorer.h>
#include <libcaer/libcaer.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    if (argc != 4)
        return 2;
    const char *model = argv[1];
    uint16_t type = strncmp(model, "davis", 5) == 0 ? CAER_DEVICE_DAVIS
                    : strcmp(model, "dvs128") == 0  ? CAER_DEVICE_DVS128
                                                    : CAER_DEVICE_DVXPLORER;
    caerDeviceHandle device = caerDeviceOpen(1, type, 0, 0, NULL);
    if (!device) {
        fprintf(stderr, "not opened\n");
        return 1;
    }
    int width, height;
    if (type == CAER_DEVICE_DAVIS) {
        struct caer_davis_info info = caerDavisInfoGet(device);
        width = info.dvsSizeX, height = info.dvsSizeY;
    } else if (type == CAER_DEVICE_DVS128) {
        struct caer_dvs128_info info = caerDVS128InfoGet(device);
        width = info.dvsSizeX, height = info.dvsSizeY;
    } else {
        struct caer_dvx_info info = caerDVXplorerInfoGet(device);
        width = info.dvsSizeX, height = info.dvsSizeY;
    }
    caerDeviceSendDefaultConfig(device);
    caerDeviceConfigSet(device, CAER_HOST_CONFIG_DATAEXCHANGE, CAER_HOST_CONFIG_DATAEXCHANGE_BLOCKING, false);

    /* A bias of the DAVIS and of the DVS128; a register of the DVXplorer's sensor. */
    int8_t module = type == CAER_DEVICE_DVXPLORER ? DVX_DVS : 5;
    uint8_t parameter = type == CAER_DEVICE_DVXPLORER ? DVX_DVS_RUN : 9;
    uint32_t written = type == CAER_DEVICE_DVXPLORER ? 0 : 1234, read = 0;
    if (type == CAER_DEVICE_DVS128)
        module = DVS128_CONFIG_BIAS, parameter = DVS128_CONFIG_BIAS_DIFFON;
    if (type == CAER_DEVICE_DAVIS)
        module = DAVIS_CONFIG_BIAS;
    if (!caerDeviceDataStart(device, NULL, NULL, NULL, NULL, NULL)) {
        fprintf(stderr, "not started\n");
        return 1;
    }
    if (type != CAER_DEVICE_DVXPLORER) {
        caerDeviceConfigSet(device, module, parameter, written);
        caerDeviceConfigGet(device, module, parameter, &read);
    }
    /* As a viewer does when it connects; the MIPI variant has no such reset. */
    if (type == CAER_DEVICE_DAVIS)
        caerDeviceConfigSet(device, DAVIS_CONFIG_MUX, DAVIS_CONFIG_MUX_TIMESTAMP_RESET, 1);
    else if (type == CAER_DEVICE_DVS128)
        caerDeviceConfigSet(device, DVS128_CONFIG_DVS, DVS128_CONFIG_DVS_TIMESTAMP_RESET, 1);

    FILE *out = fopen(argv[3], "wb");
    if (!out)
        return 1;
    unsigned long events = 0, resets = 0, wraps = 0;
    double end = now() + atof(argv[2]);
    while (now() < end) {
        caerEventPacketContainer container = caerDeviceDataGet(device);
        if (!container) {
            struct timespec pause = {0, 1000000};
            nanosleep(&pause, NULL);
            continue;
        }
        for (int32_t i = 0; i < caerEventPacketContainerGetEventPacketsNumber(container); i++) {
            caerEventPacketHeader packet = caerEventPacketContainerGetEventPacket(container, i);
            if (!packet)
                continue;
            if (caerEventPacketHeaderGetEventType(packet) == SPECIAL_EVENT) {
                caerSpecialEventPacket specials = (caerSpecialEventPacket)packet;
                for (int32_t j = 0; j < caerEventPacketHeaderGetEventNumber(packet); j++) {
                    uint8_t kind = caerSpecialEventGetType(caerSpecialEventPacketGetEvent(specials, j));
                    resets += kind == TIMESTAMP_RESET;
                    wraps += kind == TIMESTAMP_WRAP;
                }
            }
            if (caerEventPacketHeaderGetEventType(packet) != POLARITY_EVENT)
                continue;
            caerPolarityEventPacket polarities = (caerPolarityEventPacket)packet;
            for (int32_t j = 0; j < caerEventPacketHeaderGetEventNumber(packet); j++) {
                caerPolarityEvent event = caerPolarityEventPacketGetEvent(polarities, j);
                if (!caerPolarityEventIsValid(event))
                    continue;
                int64_t t = caerPolarityEventGetTimestamp64(event, polarities);
                uint16_t rest[4] = {caerPolarityEventGetX(event), caerPolarityEventGetY(event),
                                    caerPolarityEventGetPolarity(event), 0};
                fwrite(&t, sizeof t, 1, out);
                fwrite(rest, sizeof rest, 1, out);
                events++;
            }
        }
        caerEventPacketContainerFree(container);
    }
    fclose(out);
    caerDeviceDataStop(device);
    caerDeviceClose(&device);
    printf("{\"name\": \"libcaer\", \"size\": [%d, %d], \"events\": %lu, \"resets\": %lu, \"setting\": [%u, %u]}\n", width,
           height, events, resets, written, read);
    return 0;
}
