// A peer of Cyclone DDS that knows nothing of ROS 2. Arguments and output: ../peer.h; build.sh makes it.
//
// Not in one domain with rclpy: Cyclone DDS 0.10.2 crashes at the type information of ROS 2 Kilted.

#define _POSIX_C_SOURCE 200809L
#include <dds/dds.h>

#include "../peer.h"
#include "messages.h"

typedef event_camera_msgs_msg_dds__EventPacket_ event_packet;
typedef eecvs_msgs_msg_dds__Frame_ eecvs_frame;

union sample {
    event_packet packet;
    eecvs_frame frame;
};

// Multicast on the loopback for who seeks so, and all participants of this host one by one.
static const char *configuration =
    "<General><Interfaces><NetworkInterface address='127.0.0.1' multicast='true'/></Interfaces>"
    "<AllowMulticast>spdp</AllowMulticast></General>"
    "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
    "<Peers><Peer address='127.0.0.1'/></Peers><SPDPInterval>1s</SPDPInterval></Discovery>";

static dds_entity_t made(dds_entity_t entity, const char *what) {
    if (entity >= 0) return entity;
    fprintf(stderr, "cyclone: %s: %s\n", what, dds_strretcode(entity));
    exit(1);
}

static void put(union sample *to, const struct options *o, const struct message *m) {
    memset(to, 0, sizeof *to);
    std_msgs_msg_dds__Header_ *header = o->frame ? &to->frame.header : &to->packet.header;
    header->stamp.sec = m->sec;
    header->stamp.nanosec = m->nanosec;
    header->frame_id = (char *)m->frame_id;
    if (o->frame) {
        eecvs_frame *f = &to->frame;
        f->seq = m->seq, f->t0_us = m->time, f->duration_us = m->duration_us;
        f->height = m->height, f->width = m->width, f->events = m->events;
        f->operator_name = (char *)m->name;
        f->data._buffer = (uint8_t *)m->data, f->data._length = f->data._maximum = (uint32_t)m->length;
    } else {
        event_packet *p = &to->packet;
        p->height = m->height, p->width = m->width, p->seq = m->seq, p->time_base = m->time;
        p->encoding = (char *)m->name, p->is_bigendian = m->is_bigendian;
        p->events._buffer = (uint8_t *)m->data, p->events._length = p->events._maximum = (uint32_t)m->length;
    }
}

static struct message get(const union sample *from, const struct options *o) {
    const event_packet *p = &from->packet;
    const eecvs_frame *f = &from->frame;
    if (o->frame)
        return (struct message){
            .sec = f->header.stamp.sec, .nanosec = f->header.stamp.nanosec, .frame_id = f->header.frame_id, .height = f->height,
            .width = f->width, .duration_us = f->duration_us, .events = f->events, .seq = f->seq, .time = f->t0_us,
            .name = f->operator_name, .data = f->data._buffer, .length = f->data._length};
    return (struct message){
        .sec = p->header.stamp.sec, .nanosec = p->header.stamp.nanosec, .frame_id = p->header.frame_id, .height = p->height,
        .width = p->width, .seq = p->seq, .time = p->time_base, .name = p->encoding, .is_bigendian = p->is_bigendian,
        .data = p->events._buffer, .length = p->events._length};
}

static int talk(const struct options *o, dds_entity_t participant, dds_entity_t topic, const dds_qos_t *qos) {
    dds_entity_t writer = made(dds_create_writer(participant, topic, qos, NULL), "no writer can be created");
    say_ready(o);
    dds_publication_matched_status_t status = {0};
    for (double waited = 0; dds_get_publication_matched_status(writer, &status), !status.current_count; waited += 0.05) {
        if (waited > o->seconds) {
            fprintf(stderr, "cyclone: no subscriber appeared\n");
            return 1;
        }
        nap(0.05);
    }
    printf("{\"matched\": %u}\n", status.current_count);
    // The subscriber may learn of this writer a little later than this writer of it.
    nap(1);
    uint8_t *data = malloc(o->bytes + 1);
    char frame_id[32];
    int64_t start = now(CLOCK_MONOTONIC);
    uint64_t sent = 0;
    for (uint64_t i = 0; i < o->count; i++) {
        if (is_left_out(o, i)) continue;
        struct message m = fill(o, i, data, frame_id);
        union sample sample;
        put(&sample, o, &m);
        nap((double)i / o->rate - (double)(now(CLOCK_MONOTONIC) - start) / 1e9);
        made(dds_write(writer, &sample), "a message cannot be written");
        say("sent", i, o, &m);
        sent++;
    }
    // What is on its way arrives.
    nap(1);
    free(data);
    printf("{\"summary\": {\"sent\": %" PRIu64 "}}\n", sent);
    return 0;
}

static int listen(const struct options *o, dds_entity_t participant, dds_entity_t topic, const dds_qos_t *qos) {
    dds_entity_t reader = made(dds_create_reader(participant, topic, qos, NULL), "no reader can be created");
    say_ready(o);
    struct tally t = {0};
    int64_t end = now(CLOCK_MONOTONIC) + (int64_t)(o->seconds * SECOND);
    while (t.received < o->count && now(CLOCK_MONOTONIC) < end) {
        void *loan = NULL;
        dds_sample_info_t info;
        dds_return_t n = made(dds_take(reader, &loan, &info, 1, 1), "messages cannot be taken");
        if (n == 0) {
            nap(0.001);
            continue;
        }
        if (info.valid_data) {
            struct message m = get(loan, o);
            take(&t, o, &m);
        }
        dds_return_loan(reader, &loan, n);
    }
    say_received(&t);
    return 0;
}

int main(int argc, char **argv) {
    struct options o = parse(argc, argv);
    made(dds_create_domain(o.domain, configuration), "no domain can be created");
    dds_entity_t participant = made(dds_create_participant(o.domain, NULL, NULL), "no participant can be created");
    const dds_topic_descriptor_t *type = o.frame ? &eecvs_msgs_msg_dds__Frame__desc : &event_camera_msgs_msg_dds__EventPacket__desc;
    dds_entity_t topic = made(dds_create_topic(participant, type, o.topic, NULL, NULL), "no topic can be created");
    dds_qos_t *qos = dds_create_qos();
    dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, DEPTH);
    int status = (o.talk ? talk : listen)(&o, participant, topic, qos);
    dds_delete_qos(qos);
    dds_delete(DDS_CYCLONEDDS_HANDLE);
    return status;
}
