// A peer of Fast DDS 2 that knows nothing of ROS 2. Arguments and output: ../peer.h; build.sh makes it.

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPFinder.h>
#include <fastrtps/utils/IPLocator.h>
#include <vector>

#include "../peer.h"
#include "messagesPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using eprosima::fastdds::rtps::UDPv4TransportDescriptor;
using eprosima::fastrtps::rtps::IPLocator;
using event_camera_msgs::msg::dds_::EventPacket_;
using eecvs_msgs::msg::dds_::Frame_;

static void put(EventPacket_ &to, const message &m) {
    to.header().stamp().sec(m.sec);
    to.header().stamp().nanosec(m.nanosec);
    to.header().frame_id(m.frame_id);
    to.height(m.height);
    to.width(m.width);
    to.seq(m.seq);
    to.time_base(m.time);
    to.encoding(m.name);
    to.is_bigendian(m.is_bigendian);
    to.events().assign(m.data, m.data + m.length);
}

static void put(Frame_ &to, const message &m) {
    to.header().stamp().sec(m.sec);
    to.header().stamp().nanosec(m.nanosec);
    to.header().frame_id(m.frame_id);
    to.seq(m.seq);
    to.t0_us(m.time);
    to.duration_us(m.duration_us);
    to.height(m.height);
    to.width(m.width);
    to.events(m.events);
    to.operator_name(m.name);
    to.data().assign(m.data, m.data + m.length);
}

static message get(const EventPacket_ &from) {
    return {from.header().stamp().sec(), from.header().stamp().nanosec(), from.height(), from.width(), 0, 0, from.seq(),
            from.time_base(), from.header().frame_id().c_str(), from.encoding().c_str(), from.is_bigendian(),
            from.events().data(), from.events().size()};
}

static message get(const Frame_ &from) {
    return {from.header().stamp().sec(), from.header().stamp().nanosec(), from.height(), from.width(), from.duration_us(),
            from.events(), from.seq(), from.t0_us(), from.header().frame_id().c_str(), from.operator_name().c_str(), false,
            from.data().data(), from.data().size()};
}

static int failed(const char *what) {
    fprintf(stderr, "fastdds: %s\n", what);
    return 1;
}

template <class T>
static int talk(const options &o, DomainParticipant *participant, Topic *topic) {
    DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = BEST_EFFORT_RELIABILITY_QOS;
    qos.history().depth = DEPTH;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    // Messages larger than a datagram, and types that are not plain.
    qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
    DataWriter *writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
    if (!writer) return failed("no writer can be created");
    say_ready(&o);
    PublicationMatchedStatus status;
    for (double waited = 0; writer->get_publication_matched_status(status), !status.current_count; waited += 0.05) {
        if (waited > o.seconds) return failed("no subscriber appeared");
        nap(0.05);
    }
    printf("{\"matched\": %d}\n", status.current_count);
    // The subscriber may learn of this writer a little later than this writer of it.
    nap(1);
    std::vector<uint8_t> data(o.bytes);
    char frame_id[32];
    int64_t start = now(CLOCK_MONOTONIC);
    T sample;
    uint64_t sent = 0;
    for (uint64_t i = 0; i < o.count; i++) {
        if (is_left_out(&o, i)) continue;
        message m = fill(&o, i, data.data(), frame_id);
        put(sample, m);
        nap(i / o.rate - (now(CLOCK_MONOTONIC) - start) / 1e9);
        if (!writer->write(&sample)) return failed("a message cannot be written");
        say("sent", i, &o, &m);
        sent++;
    }
    // What is on its way arrives.
    nap(1);
    printf("{\"summary\": {\"sent\": %" PRIu64 "}}\n", sent);
    return 0;
}

template <class T>
static int listen(const options &o, DomainParticipant *participant, Topic *topic) {
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    qos.reliability().kind = BEST_EFFORT_RELIABILITY_QOS;
    qos.history().depth = DEPTH;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    DataReader *reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, qos);
    if (!reader) return failed("no reader can be created");
    say_ready(&o);
    tally t = {};
    int64_t end = now(CLOCK_MONOTONIC) + (int64_t)(o.seconds * SECOND);
    T sample;
    SampleInfo info;
    while (t.received < o.count && now(CLOCK_MONOTONIC) < end) {
        if (reader->take_next_sample(&sample, &info) != ReturnCode_t::RETCODE_OK)
            reader->wait_for_unread_message(eprosima::fastrtps::Duration_t(0.05));
        else if (info.valid_data) {
            message m = get(sample);
            take(&t, &o, &m);
        }
    }
    say_received(&t);
    return 0;
}

int main(int argc, char **argv) {
    options o = parse(argc, argv);
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    auto udp = std::make_shared<UDPv4TransportDescriptor>();
    // ROS 2 tells addresses of this host other than the loopback's, which Fast DDS does not take unless they are
    // listed; multicast of TTL 0 stays on this host all the same.
    eprosima::fastrtps::rtps::LocatorList_t addresses;
    eprosima::fastrtps::rtps::IPFinder::getIP4Address(&addresses);
    udp->interfaceWhiteList = {"127.0.0.1"};
    for (const auto &each : addresses) udp->interfaceWhiteList.push_back(IPLocator::toIPv4string(each));
    udp->TTL = 0;
    // As far as the system lets sockets have them.
    udp->sendBufferSize = udp->receiveBufferSize = 4 << 20;
    // Participants of this host that are sought without multicast.
    udp->maxInitialPeersRange = 32;
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(udp);
    eprosima::fastrtps::rtps::Locator_t multicast, loopback;
    IPLocator::setIPv4(multicast, "239.255.0.1");
    multicast.port = 7400 + 250 * o.domain;
    IPLocator::setIPv4(loopback, "127.0.0.1");
    auto &discovery = qos.wire_protocol().builtin;
    discovery.initialPeersList.push_back(multicast);
    discovery.initialPeersList.push_back(loopback);
    discovery.discovery_config.leaseDuration_announcementperiod = eprosima::fastrtps::Duration_t(1, 0);
    DomainParticipant *participant = DomainParticipantFactory::get_instance()->create_participant(o.domain, qos);
    if (!participant) return failed("no participant can be created");
    TypeSupport type(o.frame ? (TopicDataType *)new eecvs_msgs::msg::dds_::Frame_PubSubType()
                             : new event_camera_msgs::msg::dds_::EventPacket_PubSubType());
    type.register_type(participant);
    Topic *topic = participant->create_topic(o.topic, type.get_type_name(), TOPIC_QOS_DEFAULT);
    if (!topic) return failed("no topic can be created");
    int status = o.talk ? (o.frame ? talk<Frame_> : talk<EventPacket_>)(o, participant, topic)
                        : (o.frame ? listen<Frame_> : listen<EventPacket_>)(o, participant, topic);
    participant->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant);
    return status;
}
