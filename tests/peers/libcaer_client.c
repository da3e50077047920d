/* A camera opened by libcaer: `libcaer_client MODEL SECONDS OUT COUNT`.
 *
 * Writes each event as 16 bytes to OUT: time in us (i64), x, y, polarity (u16 each), 2 bytes of 0. Prints one line of
 * JSON: the sensor's size, how long no event came after the first COUNT (0 if others came with them), the number of
 * resets of the clock that were reported, and a setting as it was written and as it was read back. */

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
    if (argc != 5)
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

    /* A bias; of the DVXplorer, whose firmware has those, the range of its accelerometer. */
    int8_t module = DVX_IMU;
    uint8_t parameter = DVX_IMU_ACCEL_RANGE;
    uint32_t written = 3, read = 0;
    if (type == CAER_DEVICE_DAVIS)
        module = DAVIS_CONFIG_BIAS, parameter = DAVIS346_CONFIG_BIAS_ONBN, written = 1234;
    else if (type == CAER_DEVICE_DVS128)
        module = DVS128_CONFIG_BIAS, parameter = DVS128_CONFIG_BIAS_DIFFON, written = 1234;
    if (!caerDeviceDataStart(device, NULL, NULL, NULL, NULL, NULL)) {
        fprintf(stderr, "not started\n");
        return 1;
    }
    caerDeviceConfigSet(device, module, parameter, written);
    caerDeviceConfigGet(device, module, parameter, &read);
    /* As a viewer does when it connects; the MIPI variant has no such reset. */
    if (type == CAER_DEVICE_DAVIS)
        caerDeviceConfigSet(device, DAVIS_CONFIG_MUX, DAVIS_CONFIG_MUX_TIMESTAMP_RESET, 1);
    else if (type == CAER_DEVICE_DVS128)
        caerDeviceConfigSet(device, DVS128_CONFIG_DVS, DVS128_CONFIG_DVS_TIMESTAMP_RESET, 1);

    FILE *out = fopen(argv[3], "wb");
    if (!out)
        return 1;
    unsigned long events = 0, resets = 0, count = strtoul(argv[4], NULL, 10);
    double complete = 0, silence = 0;
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
                }
            }
            if (caerEventPacketHeaderGetEventType(packet) != POLARITY_EVENT)
                continue;
            if (events == count && complete > 0 && silence == 0)
                silence = now() - complete;
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
            if (events == count && complete == 0)
                complete = now();
        }
        caerEventPacketContainerFree(container);
    }
    fclose(out);
    caerDeviceDataStop(device);
    caerDeviceClose(&device);
    printf("{\"name\": \"libcaer\", \"size\": [%d, %d], \"silence_s\": %f, \"resets\": %lu, \"setting\": [%u, %u]}\n",
           width, height, silence, resets, written, read);
    return 0;
}
